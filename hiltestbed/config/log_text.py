"""A dataset with guesses, as commented YAML."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from hiltestbed.config.log_columns import Log, listed, quoted, range_of
from hiltestbed.config.log_guesses import ARM, Entry
from hiltestbed.measured.roles import BARE, joints_of

KINDS = (
    "drive: force or current to position; servo: command to position; damper: displacement to force"
)
BELIEVED = {  # of an axis
    "drive": "fill in: {mass: ...} [kg; of an axis that rotates: kg m^2]; gain, viscous, coulomb, "
    "offset",
    "servo": "delay [s], bandwidth [Hz], damping_ratio; left out: it follows its command",
    "damper": "stiffness [N/m], damping [N s/m], preload [N]",
    "arm": "beside the model: gain [N m/A], viscous, coulomb, offset, armature",
    "": "what you believe of it",
}


def dataset_text(
    path: Path, beside: Path, runs: Sequence[str], log: Log, entries: Sequence[Entry]
) -> str:
    """The dataset of a docking rig at ``path``, with its scenario ``beside`` it."""
    lines = [
        *_head(path, log),
        f"# {beside}: rate, duration and approach are those of the log; the rest is an example:",
        "# state what you believe of your rig, its masses and inertias first.",
        f"scenario: {beside}",
        "runs:",
        *runs,
        "  # - {file: ..., set: {approach.velocity.2: 0.05}}   # a further run, and what differs",
        "channels:   # pushing gives fz > 0; if not, scale: -1 for all forces and torques",
        *_lines(entries, log),
    ]
    return "\n".join([*lines, *_rest(log, entries)]) + "\n"


def axis_text(
    path: Path, runs: Sequence[str], log: Log, kind: str, rotates: bool, entries: Sequence[Entry]
) -> str:
    """The dataset of an axis or an arm of a ``kind``; "": it could not be guessed."""
    said = "guess" if kind else "could not be guessed; state one of them"
    about = [
        f"# {KINDS}",
        f"axis: {kind}   # {said}",
        f"rotates: {str(rotates).lower()}   # guess; true: positions in rad, forces in N m",
        f"nominal: {{}}   # {BELIEVED[kind]}",
    ]
    if kind == ARM:
        joints = ", ".join(f"{quoted(joint.name)}: {{}}" for joint in joints_of(log.roles))
        about = [
            "axis: arm   # motion of the joints to their torques",
            "model: arm.urdf   # state the URDF or MJCF of the arm; the joints by its names:",
            f"joints: {{{joints}}}   # {BELIEVED[kind]}",
        ]
    lines = [
        *_head(path, log),
        *about,
        "runs:",
        *runs,
        "  # - {file: ...}   # further runs; three of different motions are better",
        "channels:",
        *_lines(entries, log),
    ]
    if not log.own and not any(e.channel == "t" for e in entries):
        lines.append(
            "# rate: 1000.0      # [Hz] the log has no column of times: state its rate here"
        )
    return "\n".join([*lines, *_rest(log, entries)]) + "\n"


def _head(path: Path, log: Log) -> list[str]:
    rows = max((len(v) for v in log.data.values()), default=0)
    return [
        f"# From {log.path.name}: {len(log.names)} columns, {rows} rows. Correct the guesses:",
        f"#   hiltestbed check {path} && hiltestbed diagnose {path}",
        *([f"# The log names no columns. They are {BARE}."] if log.bare else []),
    ]


def _lines(entries: Sequence[Entry], log: Log) -> Iterator[str]:
    if not any(e.channel == "t" for e in entries):
        have = "the columns have times of their own" if log.own else (
            f"no column of times was found; choices: {listed(list(log.roles))}"
        )  # fmt: skip
        yield f"  # t: {have}"
    for e in entries:
        if not e.column:
            yield f"  # {e.channel}: {{column: ...}}   # {e.why}"
            continue
        unit = (f", unit: {e.unit}" if e.unit else "") + (", scale: -1" if e.turned else "")
        yield f"  {e.channel}: {{column: {quoted(e.column)}{unit}}}   # {e.why}"


def _rest(log: Log, entries: Sequence[Entry]) -> list[str]:
    """What is not used."""
    used = {e.column for e in entries}
    moving = [n for n in log.names if n not in used and n in log.roles]
    still = [n for n in log.names if n not in used and n not in log.roles]
    out = [f"# not used: {listed(moving)}"] if moving else []
    if log.bare:
        out = [f"# not used: {quoted(n)}, {range_of(log.data[n])}" for n in moving]
    return out + ([f"# constant, empty or no numbers: {listed(still)}"] if still else [])
