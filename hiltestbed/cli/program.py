"""The program: all commands, their common options, and the handling of errors."""

from __future__ import annotations

import json
import sys
from typing import Annotated

import typer

from hiltestbed.cli import contact, devices, scenarios, studies
from hiltestbed.errors import HiltestbedError, InputError
from hiltestbed.process import interrupt, memory
from hiltestbed.run_folder.folders import FIGURES_APART

app = typer.Typer(
    help="A hardware-in-the-loop contact simulator for spacecraft docking, in software.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"hiltestbed {version('hiltestbed')}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
    plugin: Annotated[
        list[str] | None,
        typer.Option(
            "--plugin",
            metavar="MODULE",
            help="Load your own effects, methods, mechanisms or platforms: a module, or a .py "
            "file (repeatable, with every command).",
        ),
    ] = None,
    figures: Annotated[
        bool,
        typer.Option(
            "--figures",
            help="Also write the figures of reports as PNG and SVG files beside them (with every "
            "command).",
        ),
    ] = False,
) -> None:
    FIGURES_APART.set(figures)
    memory.refuse_too_small()
    if plugin and not {"--help", "-h"} & set(sys.argv):
        from hiltestbed import plugins

        plugins.load(plugin)


for group in (scenarios, contact, studies, devices):
    for command in group.app.registered_commands:
        command.epilog = (
            "With every command: --plugin MODULE, --figures (explained by hiltestbed --help)."
        )
    app.add_typer(group.app)


def _fail(error: BaseException, text: str, status: int) -> int:
    """Print an error to standard error, with --json also as the only object on standard output."""
    if "--json" in sys.argv:
        faults = [vars(fault) for fault in error.faults] if isinstance(error, InputError) else []
        print(
            json.dumps({"status": "error", "exit_status": status, "error": text, "faults": faults})
        )
    print(text, file=sys.stderr)
    return status


def main() -> None:
    """Runs a command and turns errors into a message and an exit status."""
    try:
        status = _run()
        sys.stdout.flush()
    except BrokenPipeError:
        status = 1
    except HiltestbedError as error:  # standard output cannot be written
        print(error, file=sys.stderr)
        status = error.exit_status
    sys.exit(status)


def _common_first(arguments: list[str]) -> list[str]:
    """The arguments with ``--figures`` and every ``--plugin MODULE`` moved to the front."""
    ahead, rest = [], []
    waiting = iter(arguments)
    for argument in waiting:
        if argument == "--":
            rest += [argument, *waiting]
        elif argument == "--plugin":
            ahead += [
                argument,
                *([following] if (following := next(waiting, None)) is not None else []),
            ]
        elif argument == "--figures" or argument.startswith("--plugin="):
            ahead.append(argument)
        else:
            rest.append(argument)
    return [*ahead, *rest]


def _run() -> int:
    try:
        app(_common_first(sys.argv[1:]))
    except SystemExit as ended:  # raised by typer: 2 for a wrong call, 130 after Ctrl-C
        return ended.code if ended.code in (0, 1, 2, 3) else int(ended.code is not None)  # type: ignore[return-value]
    except HiltestbedError as error:
        return _fail(error, str(error), error.exit_status)
    except KeyboardInterrupt as error:
        return _fail(error, "interrupted", 1)
    except BrokenPipeError:
        raise
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return _fail(error, f"{where}{error.strerror or error}", 1)
    except (ImportError, RuntimeError, SystemError) as error:
        if interrupt.asked():
            return _fail(error, "interrupted", 1)
        if memory.limit() is not None:
            return _fail(error, memory.sentence(error), 1)
        if not isinstance(error, ImportError):
            raise
        return _fail(
            error,
            f"a package cannot be loaded: {error}; install it again; hiltestbed doctor lists the "
            f"packages",
            1,
        )
    except MemoryError as error:
        return _fail(error, "out of memory; a shorter duration or a lower rate needs less", 1)
    except Exception as error:  # whatever a library makes of Ctrl-C or a failed allocation
        if interrupt.asked():
            return _fail(error, "interrupted", 1)
        if memory.limit() is None:
            raise
        return _fail(error, memory.sentence(error), 1)
    return 0
