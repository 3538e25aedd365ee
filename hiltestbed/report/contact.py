"""What `hiltestbed contact` says of a spring and damper: figures, and one page with one picture."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hiltestbed.analysis.mujoco_contact import Drop, mujoco_parameters, positive_solref
from hiltestbed.analysis.spring_damper import SpringDamper
from hiltestbed.report.page import Report, new_figure
from hiltestbed.run_folder.store import whole_folder

CONTACT = "contact.json"
ERRORS = (0.01, 0.001)  # of the CoR, for which the largest step is given
# of the rms of the force, above which a drop shows another law than a spring and damper
OTHER_LAW = 0.005


@dataclass(frozen=True)
class ContactSheet:
    """A contact at an approach ``speed`` [m/s]; ``drop``: as measured in MuJoCo, if it was;
    ``engines``: name to the CoR of the same bounce there.
    """

    contact: SpringDamper
    masses: tuple[float, float]
    speed: float
    drop: Drop | None = None
    engines: tuple[tuple[str, float], ...] = ()

    def to_json(self) -> dict[str, Any]:
        """The figures, SI; an infinite mass is null."""
        of, parameters = self.contact, mujoco_parameters(self.contact)
        found: dict[str, Any] = {
            "masses": [m if math.isfinite(m) else None for m in self.masses],
            "reduced_mass": of.mass,
            "stiffness": of.stiffness,
            "damping": of.damping,
            "damping_ratio": of.damping_ratio,
            "frequency": of.frequency / (2.0 * math.pi),
            "cor": of.cor,
            "speed": self.speed,
            "contact_time": of.contact_time,
            "peak_force": of.peak_force(self.speed),
            "penetration": of.penetration(self.speed),
            "solref": list(parameters.solref),
            "solimp": list(parameters.solimp),
            "solref_positive": positive_solref(of),
            "largest_step": {f"{100 * e:g} %": of.largest_step(e) for e in ERRORS},
            "largest_delay": {"bounce": of.neutral_delay, "latched": of.critical_delay},
        }
        if self.drop is not None:
            found["measured"] = {
                "cor": self.drop.cor,
                "contact_time": float(self.drop.time[-1]),
                "peak_force": float(self.drop.force.max()),
                "penetration": float(self.drop.penetration.max()),
                "points": self.drop.contacts,
                "misfit": self.drop.misfit,
                "step": self.drop.step,
            }
        if self.engines:
            found["engines"] = {
                name: {"cor": cor, "cor_log_error": math.log(cor / of.cor)}
                for name, cor in self.engines
            }
        return found

    def lines(self) -> list[tuple[str, str]]:
        """The figures with units, for a table."""
        of, found = self.contact, self.to_json()
        positive = found["solref_positive"]
        steps, delays = found["largest_step"], found["largest_delay"]
        drop = self.drop
        rows = [
            ("stiffness, damping", f"{of.stiffness:.6g} N/m, {of.damping:.6g} N s/m"),
            ("masses (reduced)", f"{_mass(self.masses)} ({of.mass:.5g} kg)"),
            ("frequency, damping ratio", f"{found['frequency']:.4g} Hz, {of.damping_ratio:.4g}"),
            ("coefficient of restitution", f"{of.cor:.5g}"),
            (f"at {self.speed:g} m/s: contact time", f"{1e3 * of.contact_time:.5g} ms"),
            ("  peak force", f"{found['peak_force']:.5g} N"),
            ("  penetration", f"{1e3 * found['penetration']:.5g} mm"),
            ("MuJoCo: solref", _numbers(found["solref"])),
            ("  solimp", _numbers(found["solimp"])),
            ("  or solref", _numbers(positive) if positive else "none: it needs damping"),
        ]
        rows += [
            (f"largest step, CoR to {share}", f"{1e3 * s:.4g} ms") for share, s in steps.items()
        ]
        rows += [
            ("largest delay: CoR of a bounce is 1", f"{1e3 * delays['bounce']:.4g} ms"),
            ("  a latched contact diverges", f"{1e3 * delays['latched']:.4g} ms"),
        ]
        if drop is not None:
            law = "a spring and damper" if drop.misfit < OTHER_LAW else "another law"
            rows += [
                ("measured by a drop: CoR", f"{drop.cor:.5g}"),
                ("  points of contact", str(drop.contacts)),
                ("  force beside k x + c v", f"{100 * drop.misfit:.2g} % rms: {law}"),
            ]
        rows += [
            (f"{name}: CoR, ln(e/e_ref)", f"{cor:.5g}, {math.log(cor / of.cor):+.5f}")
            for name, cor in self.engines
        ]
        return rows


def write_contact(figures: ContactSheet, path: Path) -> None:
    """Write contact.json and report.html. Raises InputError if the folder has other contents."""
    with whole_folder(path, mark=CONTACT) as folder:
        text = json.dumps(figures.to_json(), indent=1, allow_nan=False)
        (folder / CONTACT).write_text(text + "\n", encoding="utf-8")
        of = figures.contact
        page = Report(f"Contact of {of.stiffness:.4g} N/m and {of.damping:.4g} N s/m")
        page.lead(
            f"It returns {100 * of.cor:.3g} % of the approach speed. A force that is later than "
            f"{1e3 * of.neutral_delay:.3g} ms makes the rebound faster than the approach."
        )
        page.table(["figure", "value"], figures.lines())
        page.figure(_figure(figures), "Force of the bounce; CoR over the step and over the delay.")
        page.write(folder / "report.html")


def _figure(figures: ContactSheet) -> Any:
    of, speed = figures.contact, figures.speed
    figure, (force, step, delay) = new_figure(11.0, 3.4, ncols=3)
    z, w = of.damping_ratio, of.frequency
    t = np.linspace(0.0, of.contact_time, 400)
    root = np.emath.sqrt(1.0 - z * z) if z != 1.0 else 1e-9
    x = (speed / (w * root) * np.exp(-z * w * t) * np.sin(root * w * t + 0j)).real
    force.plot(1e3 * t, of.stiffness * x + of.damping * np.gradient(x, t), label="closed form")
    if figures.drop is not None:
        force.plot(1e3 * figures.drop.time, figures.drop.force, "--", label="drop in MuJoCo")
        force.legend()
    force.set(xlabel="time [ms]", ylabel="force [N]")
    steps = of.contact_time / np.geomspace(4.0, 400.0, 25)
    step.loglog(1e3 * steps, [100.0 * of.stepped_errors(h).max() for h in steps])
    for share in ERRORS:
        step.axhline(100.0 * share, color="0.6", linewidth=0.8)
    step.set(xlabel="step [ms]", ylabel="worst error of the CoR [%]")
    late = np.linspace(0.0, max(2.0 * of.neutral_delay, 0.1 * of.contact_time), 25)
    delay.plot(1e3 * late, [of.late_cor(d) for d in late])
    delay.axhline(1.0, color="0.6", linewidth=0.8)
    delay.set(xlabel="delay of the force [ms]", ylabel="CoR")
    return figure


def _numbers(values: Any) -> str:
    return " ".join(f"{v:.6g}" for v in values)


def _mass(masses: tuple[float, float]) -> str:
    return " and ".join(f"{m:.5g} kg" if math.isfinite(m) else "fixed" for m in masses)
