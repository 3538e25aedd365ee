"""Typical errors in records between rig and dataset: `DISTORTIONS[name].apply(table)` changes the
columns of every run in place.

A table maps the names of the columns to their rows. `verdict` is the result that the check must
give: refused before the fit, or remarked on, where a good diagnosis is possible with the rest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hiltestbed.signals import GROUPS
from tests.measured.bounce import Table, changed

Verdict = Literal["refused", "remarked"]
LENGTHS = {
    "mm": 1e3,
    "cm": 1e2,
    "inch": 1 / 0.0254,
    "feet": 1 / 0.3048,
    "x10": 10.0,
    "x100": 100.0,
    "/10": 0.1,
}
FORCES = {
    "lbf": 1 / 4.4482216152605,
    "kgf": 1 / 9.80665,
    "daN": 0.1,
    "kN": 1e-3,
    "mN": 1e3,
    "x10": 10.0,
    "x100": 100.0,
    "/100": 0.01,
}


@dataclass(frozen=True)
class Distortion:
    """A change of a record; check: the `accept` key of the check that refuses it, if one does."""

    apply: Callable[[Table], None]
    verdict: Verdict = "refused"
    check: str = ""


def _pairs(first: str, second: str) -> list[tuple[str, str]]:
    """Two columns, or those of two groups."""
    if first not in GROUPS:
        return [(first, second)]
    return [(f"{first}.{p}", f"{second}.{p}") for p in GROUPS[first].parts]


def _exchanged(first: str, second: str) -> Callable[[Table], None]:
    def change(table: Table) -> None:
        for a, b in _pairs(first, second):
            table[a], table[b] = table[b], table[a]

    return change


def _each(*changes: Callable[[Table], None]) -> Callable[[Table], None]:
    def change(table: Table) -> None:
        for one in changes:
            one(table)

    return change


swapped_axes = _each(
    _exchanged("wrench_meas.fx", "wrench_meas.fz"), _exchanged("wrench_comp.fx", "wrench_comp.fz")
)


def _copied(source: str, target: str) -> Callable[[Table], None]:
    def change(table: Table) -> None:
        for a, b in _pairs(source, target):
            table[b] = table[a].copy()

    return change


def _held(*names: str) -> Callable[[Table], None]:
    """Columns that are constant at their first value."""

    def change(table: Table) -> None:
        for name in names:
            for column in [c for c in table if c == name or c.startswith(name + ".")]:
                table[column] = np.full(len(table[column]), table[column][0])

    return change


def _shifted(group: str, rows: int) -> Callable[[Table], None]:
    """A group delayed by `rows` in the record (advanced if negative), constant at the ends."""

    def change(table: Table) -> None:
        for column in [c for c in table if c.startswith(group + ".")]:
            n = len(table[column])
            table[column] = table[column][np.clip(np.arange(n) - rows, 0, n - 1)]

    return change


def without(*groups: str) -> Callable[[Table], None]:
    def change(table: Table) -> None:
        for column in [c for c in table if c.rpartition(".")[0] in groups]:
            del table[column]

    return change


def lost(name: str, start: float, rows: int) -> Callable[[Table], None]:
    """A column with `rows` NaN samples, from the fraction `start` of the record on."""

    def change(table: Table) -> None:
        first = int(start * len(table[name]))
        table[name] = table[name].copy()
        table[name][first : first + rows] = np.nan

    return change


def rows(keep: Callable[[int], np.ndarray]) -> Callable[[Table], None]:
    def change(table: Table) -> None:
        kept = keep(len(table["t"]))
        for column in table:
            table[column] = table[column][kept]

    return change


def _gap(n: int) -> np.ndarray:
    return np.delete(np.arange(n), n // 2)


def w_first(table: Table) -> None:
    for group in ("pose_cmd", "pose_act"):
        x, y, z, w = (table[f"{group}.q{a}"] for a in "xyzw")
        table |= {f"{group}.qx": w, f"{group}.qy": x, f"{group}.qz": y, f"{group}.qw": z}


def _nothing_but_nan(table: Table) -> None:
    for column in table:
        if column != "t":
            table[column] = np.full(len(table[column]), np.nan)


DISTORTIONS: dict[str, Distortion] = {
    "nothing but NaN": Distortion(_nothing_but_nan),
    "force nothing but NaN": Distortion(lost("wrench_meas.fz", 0.0, 10**9), "remarked"),
    "two rows": Distortion(rows(lambda n: np.arange(2))),
    "force alone": Distortion(without("pose_cmd", "pose_act", "wrench_comp"), "remarked"),
    "no poses": Distortion(without("pose_cmd", "pose_act"), "remarked"),
    "one sample of the force missing": Distortion(lost("wrench_meas.fz", 0.5, 1), "remarked"),
    "one sample of the compensated force missing": Distortion(
        lost("wrench_comp.fz", 0.5, 1), "remarked"
    ),
    "one sample of the pose missing": Distortion(lost("pose_act.pz", 0.5, 1), "remarked"),
    "a gap of one row": Distortion(rows(_gap), "remarked"),
    "first row five ticks late": Distortion(rows(lambda n: np.arange(5, n)), "remarked"),
    "rows in the other order": Distortion(rows(lambda n: np.arange(n)[::-1])),
    "time in ms": Distortion(lambda table: table.update(t=1e3 * table["t"])),
    "quaternion w first": Distortion(w_first, check="attitude"),
    "force of the other sign": Distortion(changed("wrench", -1.0), check="sign"),
    "force along z of the other sign": Distortion(changed("wrench", -1.0, "fz"), check="sign"),
    "measured force of the other sign": Distortion(
        changed("wrench_meas", -1.0, "fz"), check="sign"
    ),
    "compensated force of the other sign": Distortion(
        changed("wrench_comp", -1.0, "fz"), check="sign"
    ),
    "pz of the other sign": Distortion(changed("pose", -1.0, "pz"), check="sign"),
    "fx and fz exchanged": Distortion(swapped_axes, check="axes"),
    "measured fy and fz exchanged": Distortion(
        _exchanged("wrench_meas.fy", "wrench_meas.fz"), check="axes"
    ),
    "pose_cmd and pose_act exchanged": Distortion(
        _exchanged("pose_cmd", "pose_act"), check="shift"
    ),
    "wrench_meas and wrench_comp exchanged": Distortion(
        _exchanged("wrench_meas", "wrench_comp"), check="shift"
    ),
    "pose_act a copy of pose_cmd": Distortion(_copied("pose_cmd", "pose_act"), check="copy"),
    "wrench_comp a copy of wrench_meas": Distortion(
        _copied("wrench_meas", "wrench_comp"), check="copy"
    ),
    "px a copy of pz": Distortion(_copied("pose_act.pz", "pose_act.px"), check="copy"),
    "fx a copy of fz": Distortion(_copied("wrench_meas.fz", "wrench_meas.fx"), check="copy"),
    "pose_act stands still": Distortion(_held("pose_act"), check="constant"),
    "pose_cmd.pz stands still": Distortion(_held("pose_cmd.pz"), check="constant"),
    "wrench_meas stands still": Distortion(_held("wrench_meas"), check="constant"),
    "wrench_comp stands still": Distortion(_held("wrench_comp"), check="constant"),
    "pose_cmd three rows late": Distortion(_shifted("pose_cmd", 3), check="shift"),
    "pose_cmd three rows early": Distortion(_shifted("pose_cmd", -3), check="shift"),
    "pose_act five rows late": Distortion(_shifted("pose_act", 5), check="shift"),
    "pose_act five rows late, without wrench_comp": Distortion(
        _each(_shifted("pose_act", 5), without("wrench_comp")), check="shift"
    ),
    "wrench_meas five rows late": Distortion(_shifted("wrench_meas", 5), "remarked"),
    "wrench_meas five rows late, without wrench_comp": Distortion(
        _each(_shifted("wrench_meas", 5), without("wrench_comp")), "remarked"
    ),
    "pose_act five rows early": Distortion(_shifted("pose_act", -5), check="shift"),
    "wrench_comp three rows late": Distortion(_shifted("wrench_comp", 3), check="shift"),
    "wrench_comp ten rows early": Distortion(_shifted("wrench_comp", -10), check="shift"),
    "wrench_meas five rows early": Distortion(_shifted("wrench_meas", -5), check="shift"),
    **{
        f"{what} in {unit}": Distortion(changed(group, factor, parts), check="unit")
        for what, group, parts, units in (
            ("pose", "pose", "px py pz", LENGTHS),
            ("reached pose", "pose_act", "px py pz", LENGTHS),
            ("force", "wrench", "", FORCES),
            ("measured force", "wrench_meas", "fx fy fz", FORCES),
            ("compensated force", "wrench_comp", "fx fy fz", FORCES),
        )
        for unit, factor in units.items()
    },
}
