"""The command line. Commands live in their own modules and are imported when they are called."""

from __future__ import annotations

import importlib
import os

import click

from pntegrity import __version__

for _name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(
        _name, "1"
    )  # before numpy is imported: small matrices run far slower on many threads

COMMANDS = {
    "run": "Monitor a real log: RINEX in, verdicts, exclusions and a report out.",
    "demo": "The same on a small embedded scenario with known faults; works offline, in seconds.",
    "monitor": "Run monitors again on a recorded run, without the raw data.",
    "audit": "Does a monitor keep its false-alarm rate on this geometry, and what would it see?",
    "calibrate": "Fit the noise to a log: of a receiver, or of a vehicle's sources.",
    "train-factors": "Thresholds of factor-set detection from logs without faults.",
    "simulate-imu": "An inertial measurement unit on the track of a real log that has none.",
    "simulate-vessel": "A vessel with several sources beside an inertial unit, to try without data.",
    "products": "Products of the atmosphere from a station whose place is known.",
    "reproduce": "A published experiment, beside its published figures.",
    "evidence": "The measured figures behind docs/results.md.",
}


class _Lazy(click.Group):
    """A group that knows its commands' names and imports them only when needed."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name not in COMMANDS:
            return None
        command: click.Command = importlib.import_module(f"pntegrity.cli.{name.replace('-', '_')}").command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.group(cls=_Lazy, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="pntegrity")
def cli() -> None:
    """Integrity monitoring: epoch by epoch, may this position be trusted?"""


def main() -> None:
    """Run the command line; input errors end it with their message and exit status 2."""
    from pntegrity.errors import InputError

    try:
        code = cli.main(prog_name="pntegrity", standalone_mode=False)
    except InputError as error:
        click.echo(f"pntegrity: {error}", err=True)
        code = 2
    except click.exceptions.Abort:
        click.echo("pntegrity: interrupted", err=True)
        code = 130
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        code = error.exit_code
    except click.ClickException as error:
        ctx = getattr(error, "ctx", None)
        hint = f" `{ctx.command_path} --help` lists the options" if ctx else ""
        click.echo(f"pntegrity: {' '.join(error.format_message().split())}{hint}", err=True)
        code = error.exit_code
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # the reader went away, as `head` does: not an error
        code = 0
    raise SystemExit(code if isinstance(code, int) else 0)
