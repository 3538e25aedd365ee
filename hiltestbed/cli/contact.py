"""`hiltestbed contact`: a spring and damper as MuJoCo's parameters and back, and what it does."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hiltestbed.cli.options import Json, Out, grouped, print_json
from hiltestbed.errors import InputError

if TYPE_CHECKING:
    from hiltestbed.analysis.spring_damper import SpringDamper

app = typer.Typer()

ENGINES = ("mujoco", "shipped", "drake", "newton")


@dataclass
class Stated:
    """The contact as numbers; None for one that is not given."""

    stiffness: Annotated[
        float | None, typer.Option("--k", metavar="K", help="Stiffness [N/m].")
    ] = None
    damping: Annotated[float | None, typer.Option("--c", metavar="C", help="Damping [N s/m].")] = (
        None
    )
    cor: Annotated[
        float | None,
        typer.Option("--cor", metavar="E", help="In place of --c: coefficient of restitution."),
    ] = None
    solref: Annotated[
        str | None,
        typer.Option("--solref", metavar="A,B", help="In place of --k and --c: MuJoCo's solref."),
    ] = None


@app.command()
@grouped
def contact(
    stated: Stated,
    mjcf: Annotated[
        Path | None,
        typer.Option("--mjcf", metavar="FILE", help="Measure two geoms of this MJCF by a drop."),
    ] = None,
    geom: Annotated[
        tuple[str, str] | None, typer.Option("--geom", metavar="A B", help="Their names.")
    ] = None,
    masses: Annotated[
        str | None,
        typer.Option("--masses", metavar="M1,M2", help="Of the bodies [kg]; inf: it is fixed."),
    ] = None,
    speed: Annotated[
        float, typer.Option("--speed", metavar="V", help="Of the approach [m/s].")
    ] = 0.03,
    engine: Annotated[
        list[str] | None,
        typer.Option(
            "--engine",
            metavar="NAME",
            help="Also run this bounce in mujoco, drake or newton (a ball on a plate, with the "
            "largest step for a CoR to 0.1 % in MuJoCo) or shipped (a bumper of this simulator, "
            "without delay); repeatable.",
        ),
    ] = None,
    out: Out = None,
    as_json: Json = False,
) -> None:
    """A contact's CoR, times and forces, as MuJoCo's solref and solimp, and the limits of step and
    delay; from numbers, or measured on two geoms of an MJCF.

    hiltestbed contact --k 1e5 --cor 0.85 --masses 500,2000

    hiltestbed contact --mjcf gripper.xml --geom finger ball
    """
    from hiltestbed.analysis.mujoco_contact import pair_in_mjcf
    from hiltestbed.analysis.spring_damper import SpringDamper, reduced_mass
    from hiltestbed.report.contact import CONTACT, ContactSheet, write_contact
    from hiltestbed.run_folder.store import refuse_foreign

    _above_zero("--speed", speed, "m/s")
    given = None if masses is None else _pair("--masses", masses, "500,2000")
    if given and (min(given) <= 0.0 or min(given) == math.inf or any(map(math.isnan, given))):
        raise InputError(
            f"--masses: must be above 0 [kg], and one of them finite (got {masses!r}); inf: fixed"
        )
    if out is not None:
        refuse_foreign(out, CONTACT)
    if (mjcf is None) != (geom is None):
        raise InputError("--mjcf and --geom go together: --mjcf FILE --geom A B")
    if mjcf is not None and geom is not None:
        if stated != Stated():
            raise InputError("--mjcf: measures stiffness and damping; leave --k, --c, --cor out")
        drop, both = pair_in_mjcf(mjcf, geom, given, speed)
        found = SpringDamper(drop.stiffness, max(drop.damping, 0.0), reduced_mass(*both))
    else:
        if given is None:
            raise InputError("--masses: is missing; give the masses [kg]: --masses 500,2000")
        drop, both = None, given
        found = _spring_damper(stated, reduced_mass(*given))
    engines = tuple((name, _cor_in(name, found, both, speed)) for name in engine or [])
    figures = ContactSheet(found, both, speed, drop, engines)
    if out is not None:
        write_contact(figures, out)
    if as_json:
        print_json(figures.to_json(), out)
        return
    from hiltestbed.report.table import print_lines

    print_lines("contact", figures.lines(), out)


def _spring_damper(stated: Stated, mass: float) -> SpringDamper:
    """The contact that the options state."""
    from hiltestbed.analysis.mujoco_contact import spring_damper_of
    from hiltestbed.analysis.spring_damper import SpringDamper, with_cor

    stiffness, damping, cor = stated.stiffness, stated.damping, stated.cor
    if stated.solref is not None:
        if stated != Stated(solref=stated.solref):
            raise InputError("--solref: states stiffness and damping; leave --k, --c, --cor out")
        return spring_damper_of(_pair("--solref", stated.solref, "0.02,1"), mass)
    if stiffness is None:
        raise InputError("--k: is missing; give the stiffness [N/m], or --solref, or --mjcf")
    _above_zero("--k", stiffness, "N/m")
    if damping is None and cor is not None:
        return with_cor(stiffness, cor, mass)
    if damping is None or cor is not None:
        raise InputError("--c or --cor: exactly one of them is needed beside --k")
    if not (math.isfinite(damping) and damping >= 0.0):
        raise InputError(f"--c: must be 0 or more [N s/m] (got {damping:g})")
    return SpringDamper(stiffness, damping, mass)


def _above_zero(option: str, value: float, unit: str) -> None:
    if not (math.isfinite(value) and value > 0.0):
        raise InputError(f"{option}: must be above 0 [{unit}] (got {value:g})")


def _pair(option: str, text: str, example: str) -> tuple[float, float]:
    """Two numbers, separated by a comma."""
    try:
        first, second = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(
            f"{option}: is not two numbers (got {text!r}); write for example {option} {example}"
        ) from None
    return first, second


def _cor_in(engine: str, contact: SpringDamper, masses: tuple[float, float], speed: float) -> float:
    """The CoR of the bounce in an engine."""
    from hiltestbed.analysis.mujoco_contact import bounce_in_mujoco, mujoco_parameters
    from hiltestbed.analysis.other_engines import cor_in_drake, cor_in_newton

    if engine in ("mujoco", "drake", "newton"):
        step = contact.largest_step(1e-3)
        if engine == "drake":
            return cor_in_drake(contact, masses, speed, step)
        if engine == "newton":
            return cor_in_newton(contact, masses, speed, step)
        return bounce_in_mujoco(mujoco_parameters(contact), masses, speed, step).cor
    if engine != "shipped":
        raise InputError(f"--engine: no engine {engine!r}; allowed are {', '.join(ENGINES)}")
    if not all(math.isfinite(m) for m in masses):
        raise InputError("--engine shipped: both bodies float; give finite --masses")
    from hiltestbed.scenario import load_scenario
    from hiltestbed.simulation import simulate

    # 200 steps a contact: semi-implicit steps are then right to 1e-3 of the CoR
    rate = max(2000, math.ceil(200.0 / contact.contact_time))
    scenario = load_scenario(
        "reference-bumper",
        {
            "rate": rate,
            "physics_rate": 4 * rate,
            "duration": 1e-3 / speed + 1.2 * contact.contact_time + 5.0 / rate,
            "spacecraft.chaser.mass": masses[0],
            "spacecraft.target.mass": masses[1],
            "approach.gap": 1e-3,
            "approach.velocity": [0.0, 0.0, speed],
            "mechanism.contact": {"stiffness": contact.stiffness, "damping": contact.damping},
            "rig.platform.tracking": "ideal",
            "sensor.delay": 0.0,
            "compensation.force": {"kind": "none"},
            "identification": {"kind": "none"},
        },
    )
    (figures,) = simulate([scenario]).figures
    if figures.cor is None:
        raise InputError(
            "--engine shipped: the bounce has no rebound; a lower --speed may have one"
        )
    return figures.cor
