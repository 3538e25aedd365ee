"""The pictures of the explanations: what a delay does to a contact, what it does to an
identification, and a cause in its residuals.

    python docs/examples/explained.py

Writes docs/explained-*.png.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import hiltestbed
from hiltestbed.analysis.metrics import energy_generated
from hiltestbed.diagnosis.report.pictures import residuals_over_time
from hiltestbed.numerical_model.bodies import approach_state
from hiltestbed.report.curves import PALETTE
from hiltestbed.report.page import new_figure

DOCS = Path(__file__).resolve().parents[1]
DPI = 90
CONTACT = {
    "rig.platform.tracking": "ideal",
    "sensor.noise": 0.0,
    "approach.gap": 0.003,
    "duration": 0.5,
}
HIDDEN = {
    "effects": [{"kind": "sensor.delay", "delay": 0.003}, {"kind": "contact.preload", "force": 5.0}]
}


def delay() -> None:
    """The force that the numerical model feels over penetration, and the energy that the rig makes,
    for three delays.
    """
    figure, (loop, energy) = new_figure(9.0, 3.4, ncols=2)
    for tau, color in zip((0.0, 0.004, 0.008), PALETTE, strict=False):
        run = hiltestbed.run(
            hiltestbed.load_scenario(
                "03-bumper-delay-uncompensated", CONTACT | {"sensor.delay": tau}
            )
        )
        trace = run.trace
        assert trace is not None
        label = f"{1e3 * tau:g} ms, e = {run.summary['cor']:.3f}"
        felt = np.abs(trace["wrench_comp.fz"]) > 0.0
        loop.plot(
            1e3 * trace["pose_act.pz"][felt],
            trace["wrench_comp.fz"][felt],
            color=color,
            linewidth=1.4,
            label=label,
        )
        made = energy_generated(trace, approach_state(run.scenario.approach), run.scenario.tick)
        energy.plot(trace.t, 1e3 * made, color=color, linewidth=1.4)
    loop.set(xlabel="penetration [mm]", ylabel="force that the numerical model feels [N]")
    loop.legend(fontsize=8, frameon=False)
    energy.set(xlabel="time [s]", ylabel="energy made by the rig [mJ]")
    figure.savefig(DOCS / "explained-delay.png", dpi=DPI)


def identification() -> None:
    """Apparent stiffness and damping over the delay between the channels, by the phasors, for three
    damping ratios.
    """
    figure, panels = new_figure(9.0, 3.2, ncols=2, sharex=True)
    lag = np.linspace(0.0, 0.2, 201)  # omega tau
    for zeta, color in zip((0.02, 0.05, 0.2), PALETTE, strict=False):
        apparent = (1.0 + 2j * zeta) * np.exp(-1j * lag)  # over k
        for axes, ratio in zip(panels, (apparent.real, apparent.imag / (2.0 * zeta)), strict=True):
            axes.plot(
                lag, 100.0 * (ratio - 1.0), color=color, linewidth=1.5, label=rf"$\zeta$ = {zeta:g}"
            )
    for axes, name in zip(panels, ("stiffness", "damping"), strict=True):
        axes.set(
            xlabel=r"$\omega\tau$",
            ylabel=f"error of the {name} [%]",
            xticks=np.arange(0.0, 0.21, 0.05),
        )
        axes.grid(alpha=0.3)
    panels[0].legend(fontsize=8, frameon=False)
    figure.savefig(DOCS / "explained-c-before-k.png", dpi=DPI)


def cause() -> None:
    """What the believed model leaves of a rig with two hidden effects, and what the model leaves
    that names them.
    """
    believed, common = (
        "04-bumper-delay-compensated",
        {"sensor.noise": 0.2, "duration": 0.8, "approach.gap": 0.003},
    )
    rng = np.random.default_rng(1)
    with TemporaryDirectory() as name:
        folder = Path(name)
        lines = ["scenario: believed.yaml", "runs:"]
        for i, speed in enumerate((0.02, 0.04)):
            run = hiltestbed.run(
                hiltestbed.load_scenario(
                    believed, common | HIDDEN | {"approach.velocity.2": speed, "seed": i}
                )
            )
            log = run.to_pandas()[
                ["pose_cmd.pz", "pose_act.pz", "wrench_meas.fz", "wrench_comp.fz"]
            ]
            log["pose_act.pz"] += 1e-6 * rng.standard_normal(len(log))
            log.to_csv(folder / f"run_{i}.csv")
            lines.append(f"  - {{file: run_{i}.csv, set: {{approach.velocity.2: {speed}}}}}")
        (folder / "believed.yaml").write_text(
            hiltestbed.dump_scenario(hiltestbed.load_scenario(believed, common)), encoding="utf-8"
        )
        (folder / "dataset.yaml").write_text("\n".join(lines) + "\n", encoding="utf-8")
        diagnosis = hiltestbed.diagnose(folder / "dataset.yaml")
    residuals_over_time(
        diagnosis.finding.series, diagnosis.compared, diagnosis.dataset.names
    ).savefig(DOCS / "explained-cause.png", dpi=DPI)


if __name__ == "__main__":
    delay()
    identification()
    cause()
