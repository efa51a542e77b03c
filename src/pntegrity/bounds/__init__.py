"""What may go wrong and how much of it is allowed: integrity support message and fault modes."""

from pntegrity.bounds.ism import CITY, MESSAGES, Ism
from pntegrity.bounds.modes import Event, FaultModes, Mode, events_of, fault_modes
from pntegrity.bounds.sectors import Sectors, sectors_at, with_risen

__all__ = [
    "CITY", "MESSAGES", "Event", "FaultModes", "Ism", "Mode", "Sectors", "events_of", "fault_modes",
    "sectors_at", "with_risen",
]  # fmt: skip
