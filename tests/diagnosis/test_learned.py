"""Laws learned from readings that were made by formulas in plain NumPy: recovered, no larger than
needed, and worth what the truth is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from hiltestbed.diagnosis.find import needless
from hiltestbed.diagnosis.learned.finding import stretches
from hiltestbed.diagnosis.learned.learn import Law, carries_over, learn
from hiltestbed.diagnosis.learned.selection import Block, Choice, choices, shape_of
from hiltestbed.diagnosis.learned.words import equation, equation_of
from hiltestbed.diagnosis.links import LinkRun, WrenchLink
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.diagnosis.result import Heldout, Learned
from hiltestbed.frames import Array
from hiltestbed.scenario import Scenario, resolved, scenario_from
from tests.slow import SLOW

from .made import NOISE, STIFFNESS, H, bounce, effect, platform_link, scenario

SPEEDS = (0.02, 0.03, 0.045, 0.06, 0.03)
DAMPING = 400.0
Force = Callable[[Array, Array, float], Array]  # of penetration, rate and believed stiffness


def linear(x: Array, v: Array, k: float) -> Array:
    return k * x + DAMPING * v


def recorded(
    force: Force,
    show: Callable[[Array], Array] = lambda f: f,
    springs: Sequence[float] = (1, 1, 1, 1, 1),
) -> Residual:
    """Bounces on a wall of this ``force``, pushing alone, read 5 ms later through a sensor that
    ``show``s it, with noise.
    """
    rng, late = np.random.default_rng(3), round(scenario().sensor.delay / H)
    runs, paths = [], []
    for speed, part in zip(SPEEDS, springs, strict=True):
        path = bounce(speed=speed)
        x = path[:, 2]
        v = np.diff(x, prepend=x[0] - speed * H) / H
        pushed = np.where(
            x > 0.0, np.maximum(force(np.maximum(x, 0.0), v, part * STIFFNESS), 0.0), 0.0
        )
        read = show(np.concatenate([np.zeros(late), pushed[:-late]]))
        measured = NOISE * rng.standard_normal((len(x), 6))
        measured[:, 2] += read
        touching = np.convolve(x > 0.0, np.ones(2 * late + 1))[: len(x)] > 0
        runs.append(LinkRun(_stiffer(part), measured, np.full((len(x), 6), NOISE), touching))
        paths.append(path)
    return Residual(WrenchLink(runs, paths))


def _stiffer(part: float) -> Scenario:
    return scenario_from(
        resolved(scenario()), set={"mechanism.contact.stiffness": part * STIFFNESS}
    )


def worth(residual: Residual, gain: Heldout) -> float:
    """The gain over the largest that there is, that of a model which leaves noise alone."""
    return gain.reduction / (1.0 - 1.0 / gain.rms_before)


def learned(residual: Residual) -> tuple[Law, Heldout]:
    found = learn(residual)
    assert found is not None
    return found


def test_a_cubic_spring_is_recovered() -> None:
    residual = recorded(lambda x, v, k: linear(x, v, k) + 3e9 * x**3)
    law, gain = learned(residual)
    assert law.effect.kind == "contact.map"
    assert worth(residual, gain) > 0.8, (
        "the deepest run is left out, too, and lies past all that was fitted"
    )
    assert carries_over(gain)
    knots = np.array(law.effect.parameters()["penetration"] or law.effect.parameters()["spring"])
    x = np.linspace(0.0005, knots[-1, 0], 100)
    force = np.interp(x, *knots.T) * (
        1.0 if law.effect.parameters()["penetration"] else STIFFNESS * x
    )
    assert np.abs(force - 3e9 * x**3).max() < 0.03 * 3e9 * x[-1] ** 3


@SLOW
def test_a_kink_with_a_friction_that_no_effect_has() -> None:
    """A spring of 60 kN/m more past 1 mm, and a force on the way in that is not there on the way
    out.
    """
    residual = recorded(
        lambda x, v, k: linear(x, v, k) + 6e4 * np.maximum(x - 1e-3, 0.0) + 8.0 * (v > 0.0)
    )
    _, gain = learned(residual)
    assert worth(residual, gain) > 0.8
    assert carries_over(gain)


def test_a_loss_on_the_way_out_is_a_part_of_the_spring_that_hangs_on_the_rate() -> None:
    springs = (1.0, 1.0, 1.0, 0.5, 2.0)
    residual = recorded(lambda x, v, k: linear(x, v, k) - 0.15 * k * x * (v < 0.0), springs=springs)
    law, gain = learned(residual)
    assert worth(residual, gain) > 0.8
    assert law.effect.parameters()["spring_rate"]


def test_the_curve_of_a_sensor_is_told_from_that_of_a_contact_by_other_known_springs() -> None:
    residual = recorded(linear, lambda f: f - 4e-4 * f**2, springs=(1.0, 1.0, 0.5, 1.0, 2.0))
    law, gain = learned(residual)
    assert law.effect.kind == "sensor.map"
    assert worth(residual, gain) > 0.9
    knots = np.array(law.effect.parameters()["reading"])
    assert np.abs(knots[:, 1] - (knots[:, 0] - 4e-4 * knots[:, 0] ** 2)).max() < 0.01 * knots[-1, 0]
    assert equation(law) is not None


@SLOW
def test_a_run_in_which_nothing_touches_bears_nothing_on_the_curve_of_a_sensor() -> None:
    touched = recorded(linear, lambda f: f - 4e-4 * f**2, springs=(1.0, 1.0, 0.5, 1.0, 2.0)).link
    assert isinstance(touched, WrenchLink)
    first, apart = touched.runs[0], touched.paths[0] - [0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0]
    noise = NOISE * np.random.default_rng(7).standard_normal(first.measured.shape)
    missed = replace(first, measured=noise, touching=np.zeros(len(apart), dtype=bool))
    law, _ = learned(Residual(WrenchLink([*touched.runs, missed], [*touched.paths, apart])))
    assert law.effect.kind == "sensor.map"
    assert law.effect.parameters()["reading"] == pytest.approx(
        np.array(learned(Residual(touched))[0].effect.parameters()["reading"]), rel=0.01
    )


def test_the_answer_of_a_platform_to_a_step_is_recovered() -> None:
    """Two poles of 12 Hz, damping ratio 0.35, 2 ms late: no effect of the vocabulary."""
    t = np.linspace(0.0, 0.12, 18)
    w, zeta = 2.0 * np.pi * 12.0, 0.35
    s = w * np.sqrt(1.0 - zeta**2)
    answer = 1.0 - np.exp(-zeta * w * t) * (np.cos(s * t) + zeta * w / s * np.sin(s * t))
    true = tuple((float(a) + 0.002, float(b)) for a, b in zip(t, answer, strict=True))
    residual = Residual(
        platform_link([effect("platform.response", step=true)], speeds=(0.02, 0.03, 0.045, 0.06))
    )
    law, gain = learned(residual)
    assert law.effect.kind == "platform.response"
    assert worth(residual, gain) > 0.8
    assert carries_over(gain)
    found, at = np.array(law.effect.parameters()["step"]), np.linspace(0.01, 0.1, 30)
    assert np.abs(np.interp(at, *found.T) - np.interp(at, *np.array(true).T)).max() < 0.1
    assert learn(Residual(platform_link(speeds=(0.02, 0.03, 0.06)))) is None


def test_nothing_is_learned_from_noise_and_nothing_from_one_run() -> None:
    assert learn(recorded(linear)) is None
    assert learn(recorded(lambda x, v, k: linear(x, v, k) + 3e9 * x**3).on([1])) is None


def test_what_is_of_another_size_in_every_run_does_not_carry_over() -> None:
    signs = iter((1.0, -1.0, 1.0, -1.0, 1.0))
    found = learn(recorded(lambda x, v, k: linear(x, v, k) + next(signs) * 2e4 * x))
    assert found is None or not carries_over(found[1])


@pytest.mark.parametrize(
    "choice", choices(Block("rate", np.linspace(-1.0, 1.0, 17), True, (3, 5, 9, 17)))
)
def test_fewer_knots_give_curves_of_the_finest(choice: Choice) -> None:
    """Straight between its own knots, nothing at 0, and odd where that is asked."""
    block = Block("rate", np.linspace(-1.0, 1.0, 17), True, (3, 5, 9, 17))
    basis = shape_of(block, choice)
    values = basis @ np.random.default_rng(0).standard_normal(basis.shape[1])
    every = choice.every(17)
    np.testing.assert_allclose(
        values, np.interp(block.places, block.places[::every], values[::every]), atol=1e-12
    )
    assert values[8] == pytest.approx(0.0, abs=1e-12)
    assert not choice.odd or np.allclose(values, -values[::-1])


def test_a_stretch_stays_within_its_ends_and_follows_what_moves() -> None:
    x = np.concatenate([np.linspace(0.0, 1.0, 50), np.linspace(1.0, 0.4, 30)])
    s = stretches(x, -0.2, 0.2, held=True)
    assert s.max() == pytest.approx(0.2)
    np.testing.assert_allclose(s[50:], np.maximum(0.2 - (1.0 - x[50:]), -0.2), atol=1e-12)


@pytest.mark.parametrize(
    ("law", "words"),
    [
        (lambda x: -3.0 * x, "-3 x"),
        (lambda x: 2.0 * x**3, "2 x^3"),
        (lambda x: 5.0 * x**1.5, "5 x^1.50"),
        (lambda x: 4.0 * np.maximum(x - 0.5, 0.0), "4 max(x - 0.5, 0)"),
    ],
)
def test_a_curve_in_a_short_equation(law: Callable[[Array], Array], words: str) -> None:
    x = np.linspace(0.0, 1.0, 201)
    assert equation_of(tuple(zip(x.tolist(), law(x).tolist(), strict=True)), "x") == words


def test_a_curve_that_no_equation_fits_has_none() -> None:
    x = np.linspace(0.0, 1.0, 17)
    assert equation_of(tuple(zip(x.tolist(), np.sin(20.0 * x).tolist(), strict=True)), "x") is None


def law_of(numbers: int, *left: float, carries: bool = True) -> Learned:
    after = float(np.sqrt(np.mean(np.square(left))))
    gain = Heldout(
        (0, 1),
        20.0,
        after,
        1.0 - after / 20.0,
        (0.5, 0.9),
        0.0,
        {i: (20.0, x) for i, x in enumerate(left)},
    )
    return Learned("contact.map", {}, "contact", numbers, gain, 0.9, carries, None, ())


def test_a_name_falls_where_curves_alone_do_as_well_with_fewer_numbers() -> None:
    assert needless(law_of(16, 2.0), law_of(17, 2.0), named=2)
    assert not needless(law_of(4, 2.0), law_of(17, 2.0), named=2), "the name makes the law simpler"
    assert not needless(law_of(16, 1.0), law_of(17, 2.0), named=2), (
        "the curves leave more without it"
    )
    assert not needless(law_of(16, 2.0), law_of(17, 2.0, carries=False), named=2)


def test_a_name_stays_that_explains_a_run_which_departs_less() -> None:
    """Both leave as much of the run that departs most, by which alone a pooled rms goes."""
    assert not needless(law_of(4, 12.1, 1.0), law_of(1, 12.0, 4.0), named=1)
    assert needless(law_of(4, 12.1, 1.0), law_of(1, 12.0, 1.0), named=1)
