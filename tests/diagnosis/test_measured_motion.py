"""A motion that was only measured is taken as smooth, one that a facility was commanded along as
uniform within a tick.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.signal import savgol_coeffs

import hiltestbed
from hiltestbed.diagnosis.layout import lay_out
from hiltestbed.diagnosis.link_model import LinkModel
from hiltestbed.diagnosis.links import WrenchLink
from hiltestbed.diagnosis.path_noise import smoothed_noise
from hiltestbed.diagnosis.paths import best_path, choose_lever, make_wrench_link
from hiltestbed.diagnosis.recorded import DatasetLayout
from hiltestbed.diagnosis.settings import SMOOTHING_ROWS
from hiltestbed.inference.model import Hypothesis
from hiltestbed.measured import load_dataset

from .recorded import dataset_of, only, with_noise

# [N/m], [N s/m], [kg], [m], [m/s]
STIFFNESS, DAMPING, MASS, GAP, SPEED = 1e5, 400.0, 100.0, 0.0023, 0.06
RATE = 2000  # [Hz]
FORCE_NOISE = 0.05  # [N]
WAVE = 50.0  # [Hz], half the frequency that the filter cuts off


def bounce() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, place past the touch and force of a mass on a spring and a damper, in closed form up to
    where it turns back.
    """
    d = 0.5 * DAMPING / MASS
    w = math.sqrt(STIFFNESS / MASS - d * d)
    t = np.arange(round(0.09 * RATE)) / RATE
    s = np.maximum(t - GAP / SPEED, 0.0)
    x = SPEED / w * np.exp(-d * s) * np.sin(w * s)
    v = SPEED * np.exp(-d * s) * (np.cos(w * s) - d / w * np.sin(w * s))
    touches = t > GAP / SPEED
    return (
        t,
        np.where(touches, x, SPEED * t - GAP),
        np.where(touches, STIFFNESS * x + DAMPING * v, 0.0),
    )


def layout_of(
    folder: Path, t: np.ndarray, place: np.ndarray, force: np.ndarray, noise: float
) -> DatasetLayout:
    """One record of a motion and its force, both with noise."""
    rng = np.random.default_rng(3)
    measured = {
        "t": t,
        "pose_act.pz": place + noise * rng.standard_normal(len(t)),
        "wrench_meas.fz": force + FORCE_NOISE * rng.standard_normal(len(t)),
    }
    pq.write_table(pa.table(measured), folder / "run.parquet")
    contact = {
        "mechanism": {"kind": "bumper", "contact": {"stiffness": STIFFNESS, "damping": DAMPING}},
        "approach.gap": GAP,
    }
    rig = {
        "rate": RATE,
        "physics_rate": 8 * RATE,
        "duration": len(t) / RATE,
        "approach.velocity.2": SPEED,
    }
    (folder / "nominal.yaml").write_text(
        hiltestbed.dump_scenario(hiltestbed.load_scenario("02-bumper", contact | rig)), "utf-8"
    )
    (folder / "dataset.yaml").write_text(
        "scenario: nominal.yaml\nruns: [{file: run.parquet}]\naccept: [unit]\n", "utf-8"
    )
    return lay_out(load_dataset(folder / "dataset.yaml"))


def test_what_smoothing_cuts_off_is_known_up_to_its_own_share(tmp_path: Path) -> None:
    """The filter leaves H of an oscillation, in phase: it cuts off 1 - H, and H (1 - H) of what it
    left, which then counts as unknown.
    """
    t = np.arange(1200) / RATE
    wave = np.sin(2.0 * math.pi * WAVE * t)
    place = np.minimum(SPEED * t - GAP, 1e-3) + 1e-4 * wave
    touches = place > 0.0
    layout = layout_of(
        tmp_path,
        t,
        place,
        np.where(touches, STIFFNESS * place + DAMPING * np.gradient(place, t), 0.0),
        5e-7,
    )
    passed = float(
        savgol_coeffs(SMOOTHING_ROWS, 3) @ np.cos(2.0 * math.pi * WAVE * np.arange(-15, 16) / RATE)
    )
    ((unknown,),) = best_path(layout, None).unknown
    inside = slice(300, 1100)
    size = float(unknown[inside, 2] @ wave[inside] / (wave[inside] @ wave[inside]))
    assert size == pytest.approx(1e-4 * passed * (1.0 - passed), rel=0.01)


def link_of(layout: DatasetLayout) -> WrenchLink:
    """Contact and sensor on the best path."""
    return make_wrench_link(layout, best_path(layout, None), layout.whole)


@pytest.mark.parametrize("noise", [0.0, 5e-7], ids=["clean", "smoothed"])
def test_the_force_of_a_smooth_motion_has_no_half_tick_of_its_acceleration(
    tmp_path: Path, noise: float
) -> None:
    """The slope of the tick that ends would add c a h/2, 0.18 N of the peak's 180 N; sampled alone
    it costs c x''' h^2/6, 1 mN.

    The last row has a tick on one side only.
    """
    t, place, force = bounce()
    off = (link_of(layout_of(tmp_path, t, place, force, noise)).shown(0)[:, 2] - force)[:-1][
        force[:-1] > 150.0
    ]
    half_tick = DAMPING * 150.0 / MASS / (2.0 * RATE)
    assert abs(np.mean(off)) < (0.02 if noise == 0.0 else 0.3) * half_tick


def test_a_bend_of_a_commanded_motion_that_smoothing_cuts_off_is_doubtful(tmp_path: Path) -> None:
    """A that stops at once loses c v = 24 N within a row, a smoothed pose within 30: newtons are
    off, beside a noise of 0.05 N.

    Elsewhere the path's noise is that of k x + c v, larger by the root of the rows that the filter
    averages, 14 of 31, over which it is alike; four copies tell it to a quarter. The first rows of
    the contact are left out, where the touch itself is smoothed.
    """
    t = np.arange(600) / RATE
    stop = 0.15  # [s]
    place = np.minimum(SPEED * t - GAP, SPEED * stop - GAP)
    force = np.where(place > 0.0, STIFFNESS * place + DAMPING * SPEED * (t < stop), 0.0)
    layout = layout_of(tmp_path, t, place, force, 5e-7)
    off = link_of(layout).shown(0)[:, 2] - force
    path = smoothed_noise(layout, best_path(layout, None), commanded=True)[0][:, 2]
    noise = np.hypot(FORCE_NOISE, path)
    near = np.abs(t - stop) * RATE < SMOOTHING_ROWS
    assert np.max(np.abs(off[near])) > 3.0
    assert np.max(np.abs(off / noise)[place > 0.0][5:]) < 4.0
    spread, slope = (
        5e-7 * RATE**n * np.linalg.norm(savgol_coeffs(SMOOTHING_ROWS, 3, deriv=n)) for n in (0, 1)
    )
    alike = 1.0 / np.sum(savgol_coeffs(SMOOTHING_ROWS, 3) ** 2)
    expected = np.hypot(
        FORCE_NOISE, math.sqrt(alike) * np.hypot(STIFFNESS * spread, DAMPING * slope)
    )
    assert np.median(noise[(t > 0.07) & ~near]) == pytest.approx(expected, rel=0.25)


def test_a_slide_of_which_only_a_noisy_pose_is_known_leaves_only_noise(tmp_path: Path) -> None:
    """The pose's noise shows in the friction and, by its lever, in the torques as well, where the
    scenario's own trace is the truth.
    """
    scenario, rng = hiltestbed.load_scenario("05-off-centre"), np.random.default_rng(5)
    kept = only(("pose_act", "wrench_meas"))

    def change(log: pa.Table) -> pa.Table:
        return with_noise(kept(log), [f"pose_act.p{axis}" for axis in "xyz"], 2e-6, rng)

    layout = lay_out(
        load_dataset(dataset_of(tmp_path, scenario, [{"duration": 0.7}], change=change))
    )
    link = choose_lever(make_wrench_link(layout, best_path(layout, None), layout.rows))
    model = LinkModel(link)
    assert model.leaves_noise(model.residuals(Hypothesis((), np.zeros(0), np.zeros(0))))
