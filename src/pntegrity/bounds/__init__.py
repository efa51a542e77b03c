"""What may go wrong and how much of it is allowed: integrity support message and fault modes."""

from pntegrity.bounds.ism import Ism
from pntegrity.bounds.modes import Event, FaultModes, Mode, events_of, fault_modes

__all__ = ["Event", "FaultModes", "Ism", "Mode", "events_of", "fault_modes"]
