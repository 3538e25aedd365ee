"""The benchmark of real-time hybrid simulation: its structure, transfer system, indices and methods
against closed forms; the public repository's figures where it is at hand.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.signal import butter, freqs_zpk, lfilter, lsim

from hiltestbed.bench.rths import problem
from hiltestbed.bench.rths.entrants import Known, Rodeac, known, shipped, uncompensated
from hiltestbed.bench.rths.measure import calibration, rths
from hiltestbed.bench.rths.problem import (
    NODE,
    SPECIMEN,
    STOREYS,
    TICK,
    Material,
    Newmark,
    Plants,
    RthsRecord,
    Substructure,
    actual_specimen,
    hybrid,
    indices,
    late,
    noise,
    planned_specimen,
    plants,
    read,
    reference,
    sampled,
    simulink_normal,
    to_actuators,
    to_node,
    transfer,
    undivided,
    without,
)
from hiltestbed.errors import InputError
from hiltestbed.frames import Array
from tests.measured_data import measured_data

RNG = np.random.default_rng(5)
NOMINAL = plants(0, RNG)
ALIKE = Known(np.ones(2), np.array([0.020, 0.010]))


def frame() -> Substructure:
    """Three storeys of 7 t on springs, and 26 rotations and vertical motions that they take along."""
    mass, stiffness = np.zeros((29, 29)), 3e6 * np.eye(29)
    mass[STOREYS, STOREYS] = 7000.0
    for low, high in ((26, 25), (25, 12)):
        stiffness[np.ix_((low, high), (low, high))] += 8e6 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    along = np.linspace(-1.0, 1.0, 29)
    stiffness += 1e5 * np.outer(along, along)
    stiffness[np.ix_(SPECIMEN, SPECIMEN)] += planned_specimen().stiffness
    return Substructure.rayleigh(mass, stiffness, 15.0, 60.0)


def shaken(t: float) -> float:
    """[m/s^2] Two periods of 1.5 Hz, then rest."""
    return np.sin(3.0 * np.pi * t) ** 3 if t < 4.0 / 3.0 else 0.0


def of_node(position: Array) -> Array:
    """Displacement and rotation of the node, as the coupler counts them."""
    return position[:, NODE] * np.array([1.0, -1.0])


def pulse() -> Array:
    """:func:`shaken` at the ticks of two seconds."""
    return np.array([shaken(k * problem.TICK) for k in range(round(2.0 / problem.TICK))])


def test_specimen_and_numerical_substructure_are_the_structure() -> None:
    whole, part = frame(), planned_specimen()
    rest = without(whole, part)
    for matrix, left, own in zip(whole, rest, part, strict=True):
        left[np.ix_(SPECIMEN, SPECIMEN)] += own
        np.testing.assert_allclose(left, matrix, rtol=0, atol=1e-9 * np.abs(matrix).max())


def test_frames_on_pins_resist_as_beam_theory_says() -> None:
    """Rotations released, a portal on pins has the lateral stiffness 12 E Ic / (h^3 (2 + L Ic/(h
    Ib))): two cantilevers on a beam in double curvature, of 6 E Ib/L; with the coupling of the
    planned one, which the source gives the other sign, 2 E Ib/L are left, a third.
    """
    for part, column, beam, ic, ib in (
        (planned_specimen().stiffness, 0.635, 0.762, 2.520 * 0.0254**4, 0.2044 * 0.0254**4),
        (actual_specimen().stiffness, 0.64135, 0.762, 0.7 * 2.520 * 0.0254**4, 4.21372e-7),
    ):
        if part.shape == (3, 3):
            lateral = part[0, 0] - part[0, 1:] @ np.linalg.solve(part[1:, 1:], part[1:, 0])
        else:  # the other node's rotation is condensed already
            k = part[NODE, :] * np.array([[1.0], [-1.0]])
            lateral = k[0, 0] - k[0, 1] * k[1, 0] / k[1, 1]
        expected = 12.0 * 200e9 * ic / column**3 / (2.0 + beam * ic / (column * ib))
        assert lateral == pytest.approx(expected, rel=1e-9)


def test_newmarks_method_converges_to_the_matrix_exponential(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A step load on two masses: second order, and no energy lost without damping."""
    s = Substructure(
        np.diag([2.0, 1.0]), np.diag([3.0, 2.0]), np.array([[900.0, -400], [-400, 500.0]])
    )
    inverse = np.linalg.inv(s.mass)
    flow = np.block([[np.zeros((2, 2)), np.eye(2)], [-inverse @ s.stiffness, -inverse @ s.damping]])
    force = np.array([1.0, 0.5])
    still = np.linalg.solve(s.stiffness, force)
    errors = []
    for tick in (1.0 / 256, 1.0 / 512):
        monkeypatch.setattr(problem, "TICK", tick)
        solver = Newmark(s, 1)
        solver._state[2] = inverse @ force  # the load acts from the start
        for _ in range(round(0.5 / tick)):
            x = solver.step(force[None])[0]
        exact = still - (expm(0.5 * flow) @ np.concatenate([still, np.zeros(2)]))[:2]
        errors.append(np.abs(x - exact).max())
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.05)


def test_a_specimen_moved_without_error_gives_the_undivided_structure(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As far as its backward differences do: to first order in the tick. Its mass is one that the
    ground does not shake, since the numerical substructure leaves the load on the specimen out.
    """
    whole = frame()
    whole.mass[20, 20] = 30.0
    place = np.zeros((29, 2))
    place[NODE, range(2)] = 1.0, -1.0
    k = planned_specimen().stiffness[np.ix_((0, 2), (0, 2))] * np.outer((1.0, -1.0), (1.0, -1.0))
    told = Substructure(*(place @ part for part in (np.diag([0.0, 20.0]), 3e-3 * k, k)))
    rest = Substructure(*(m - part @ place.T for m, part in zip(whole, told, strict=True)))
    errors = []
    for tick in (1.0 / 1024, 1.0 / 2048):
        monkeypatch.setattr(problem, "TICK", tick)
        right = undivided(whole, None, pulse()).node
        errors.append(np.abs(undivided(rest, told, pulse()).node - right).max(axis=(0, 1)))
    np.testing.assert_allclose(errors[0] / errors[1], 2.0, rtol=0.1)


def test_transfer_functions_are_those_of_their_zeros_and_poles() -> None:
    """And 0.864, 0.131, 0.140, 0.926 at rest: those of H11 and H12 are 2165.2 times 120 90 / (2.65
    40 (50^2 + 63^2) (2 pi)^2) and so on.
    """
    w = 2.0 * np.pi * np.array([0.5, 2.0, 20.0])
    for i, zeros in enumerate(([3.0], [5.0])):
        poles = [-3.5, -18.5, -50.0 - 63.0j, -50.0 + 63.0j]
        z, p = 2.0 * np.pi * -np.array(zeros), 2.0 * np.pi * np.array(poles)
        expected = freqs_zpk(z, p, problem.GAINS[i, 1], w)[1]  # type: ignore[arg-type]
        np.testing.assert_allclose([transfer(NOMINAL, 1j * x)[0, i, 1] for x in w], expected)
    rest = transfer(NOMINAL, 0.0)[0].real
    np.testing.assert_allclose(rest, [[0.8638, 0.1311], [0.1396, 0.9258]], atol=5e-5)


def test_uncertain_plants_scatter_as_stated_and_keep_the_gain() -> None:
    of = plants(2000, np.random.default_rng(3))
    assert np.abs(of.poles.real).max() < 2.0 * np.pi * 65.0
    for j, frequency in ((0, 2.65), (1, 3.5)):
        spread = np.std(of.poles[1:, j, 0].real) / (2.0 * np.pi * frequency)
        assert spread == pytest.approx((0.06, 0.03)[j], rel=0.1)  # 1/sqrt(2 2000) is 0.016
    slow = np.abs(transfer(of, 2j * np.pi * 0.01))
    np.testing.assert_allclose(slow, np.broadcast_to(slow[:1], slow.shape), rtol=1e-9)


def test_actuators_follow_as_an_independent_integration_says() -> None:
    """A held random command: the exact exponential as ``lsim`` with a step of a tick, the block
    diagram's solver within (pole times tick)^5/120 of it.
    """
    command = np.repeat(RNG.standard_normal((64, 2)), 8, axis=0)
    expected = np.zeros_like(command)
    for i in range(2):
        for j, (zeros, poles) in enumerate((((120, 90), (2.65, 40)), (([3], [5])[i], (3.5, 18.5)))):
            z = -2.0 * np.pi * np.array(zeros, dtype=float)
            p = -2.0 * np.pi * np.array([*poles, 50.0 + 63.0j, 50.0 - 63.0j])
            t = TICK * np.arange(len(command))
            system = (z, p, problem.GAINS[i, j])
            expected[:, i] += lsim(system, command[:, j], t, interp=False)[1]
    for growth, tolerance in ((np.exp, 1e-9), (problem.ode4, 1e-3)):
        found = []

        def method(n: int, rows: list = found) -> Callable:
            def command_of(target: Array, measured: Array) -> Array:
                rows.append(measured[0])
                return command[None, len(rows) - 1]

            return command_of

        readings = np.zeros((len(command), 1))
        hybrid(frame(), None, np.zeros(len(command)), NOMINAL, readings, method, growth)
        np.testing.assert_allclose(np.array(found), expected, atol=tolerance)


def test_the_hybrid_simulation_converges_to_an_independent_integration(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of structure, coupler, actuators and fed-back force as one system of differential equations:
    to first order in the tick, over which the command is held.
    """
    part = planned_specimen()
    rest, force = without(frame(), part), 0.2 * actual_specimen().stiffness
    rest.mass[np.diag_indices(29)] = np.maximum(np.diag(rest.mass), 10.0)
    nothing = np.zeros((29, 2))
    poles, residues = NOMINAL.poles[0], NOMINAL.residues[0]
    inverse, load = np.linalg.inv(rest.mass), problem.push(rest)

    def rates(t: float, state: Array) -> Array:
        u, v, x = state[:29].real, state[29:58].real, state[58:].reshape(2, 4)
        reached = np.einsum("ijp,jp->i", residues, x).real
        held = force @ to_node(reached[None])[0]
        a = inverse @ (load * shaken(t) - held - rest.damping @ v - rest.stiffness @ u)
        command = to_actuators(of_node(u[None]))[0]
        return np.concatenate([v, a, (poles * x + command[:, None]).ravel()])

    t = np.arange(1, 20) / 20.0
    solved = solve_ivp(rates, (0.0, 1.0), np.zeros(66, complex), "DOP853", t, rtol=1e-9, atol=1e-12)
    expected = of_node(solved.y[:29].real.T) * np.array([1000.0, 1.0])
    errors = []
    for tick in (1.0 / 1000, 1.0 / 4000):
        monkeypatch.setattr(problem, "TICK", tick)
        ground = np.array([shaken(k * tick) for k in range(round(1.0 / tick))])
        told = Substructure(nothing, nothing, force)
        readings = np.zeros((len(ground), 1))
        run = hybrid(rest, told, ground, NOMINAL, readings, uncompensated)
        errors.append(np.abs(run.node[np.round(t / tick).astype(int), 0] - expected).max(axis=0))
    assert (errors[0] < 0.01 * np.abs(expected).max(axis=0)).all()
    np.testing.assert_allclose(errors[0] / errors[1], 4.0, rtol=0.2)


def test_the_coupler_is_inverted_to_the_third_power_of_the_rotation() -> None:
    node = np.array([[0.004, 0.01], [-0.02, 0.03], [0.0, -0.02]])
    found = to_node(to_actuators(node))
    np.testing.assert_allclose(found[:, 1], node[:, 1], rtol=1e-9)
    off = problem.ARM * np.sin(problem.ANGLE) * np.abs(node[:, 1]) ** 3 / 6.0
    assert (np.abs(found[:, 0] - node[:, 0]) < 1.5 * off).all()


def _record(target: Array, measured: Array) -> RthsRecord:
    rows = target[:, None, None] * np.ones(2)
    upper = target[:, None, None] * np.ones(4)
    late_rows = measured[:, None, None] * np.ones(2)
    return RthsRecord(rows, late_rows, rows, late_rows, rows, upper)


@pytest.mark.parametrize("ticks", [0, 3, 20])
def test_a_pure_delay_is_j1_and_a_tone_has_its_nrms(ticks: int) -> None:
    """J1 = d; over whole periods J2 = 2 sin(w d/2) of a tone. A perfect run has none."""
    noise_like = np.convolve(RNG.standard_normal(4000), np.ones(5))
    found = indices(
        _record(noise_like, np.roll(noise_like, ticks)), 0, _record(noise_like, noise_like)
    )
    assert found is not None
    assert found["J1"] == found["J4"] == [1e3 * TICK * ticks] * 2
    w, k = 2.0 * np.pi / 256, np.arange(16 * 256)
    tone = indices(
        _record(np.sin(w * k), np.sin(w * (k - ticks))), 0, _record(np.sin(w * k), np.sin(w * k))
    )
    assert tone is not None
    np.testing.assert_allclose(tone["J2"], 200.0 * np.sin(w * ticks / 2.0), atol=1e-9)
    np.testing.assert_allclose(tone["J7"], tone["J5"])
    assert tone["J8"] == tone["J10"] == [0.0] * 4


def test_delays_count_whatever_the_sign() -> None:
    x = np.convolve(RNG.standard_normal(1000), np.ones(4))
    assert late(np.roll(-x, 7), x) == 7  # MATLAB's finddelay takes the magnitude
    assert late(x, np.roll(x, 7)) == -7


def test_noise_is_that_of_simulink_and_the_same_at_both_actuators() -> None:
    """Park and Miller's state 1 leads to 16807, 282475249 (their paper): with these, from the
    seed 1/65536 of the shift, u^2 + v^2 > 1, so the check is on the pairs of the seed 123.
    """
    state, pairs = 123 << 16, []
    while not pairs or sum(x * x for x in pairs[-1]) > 1.0:
        pair = []
        for _ in range(2):
            state = state * 16807 % (2**31 - 1)
            pair.append(2.0 * state / (2**31 - 1) - 1.0)
        pairs.append(pair)
    square = sum(x * x for x in pairs[-1])
    first = np.sqrt(-2.0 * np.log(square) / square) * pairs[-1][0]
    assert simulink_normal(123, 1)[0] == pytest.approx(first, rel=1e-12)
    many = simulink_normal(123, 20_000)
    assert abs(many.mean()) < 4.0 / np.sqrt(20_000)
    assert many.std() == pytest.approx(1.0, abs=4.0 / np.sqrt(2 * 20_000))
    still = np.zeros(50)
    readings = noise(50, 1, RNG)
    run = hybrid(frame(), None, still, plants(1, RNG), readings, uncompensated)
    np.testing.assert_array_equal(run.measured[0, :, 0], run.measured[0, :, 1])
    assert not np.allclose(run.measured[0, 0], run.measured[0, 1])


def _material() -> Material:
    theta = np.array([[1.2, -0.1, 0.2, -0.3], [0.9, 0.1, 0.1, -0.1]])
    whole = frame()
    return Material(whole.mass, whole.stiffness, {}, theta, np.tile(100.0 * np.eye(4), (2, 1, 1)))


def test_the_adaptive_compensator_solves_its_algebraic_loop() -> None:
    """Recursive least squares over the filtered readings and the filtered commands that it made
    reproduce each command as coefficients times targets, those of this very tick included.
    """
    material = _material()
    method = Rodeac(material, 1)
    targets = np.convolve(RNG.standard_normal(300), np.ones(8))[:300, None] * np.ones(2)
    measured = 0.8 * np.roll(targets, 2, axis=0)
    commands = np.array(
        [method(t[None], m[None])[0] for t, m in zip(targets, measured, strict=True)]
    )
    b, a = np.array(butter(4, 20.0, fs=1.0 / TICK))
    x, u = (np.asarray(lfilter(b, a, rows, axis=0)) for rows in (measured, commands))
    for i in range(2):
        theta, p = material.coefficients[i], material.correlation[i]
        for k in range(300):
            row, now = (
                np.array([s[k - j, i] if k >= j else 0.0 for j in range(4)]) for s in (x, targets)
            )
            gain = p @ row / (1.0 + row @ p @ row)
            theta, p = theta + gain * (u[k, i] - row @ theta), p - np.outer(gain, row @ p)
            assert commands[k, i] == pytest.approx(theta @ now, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("name", [n for n in shipped(ALIKE) if n != "adaptive_time_series"])
def test_a_ramp_is_led_by_the_told_delay(name: str) -> None:
    told = Known(np.array([1.0, 1.25]), ALIKE.delay)
    method = shipped(told)[name](1)
    speed = np.array([3.0, -2.0])  # [mm/s]
    for k in range(400):
        t = TICK * k
        command = method(speed * t * np.ones((1, 2)), np.zeros((1, 2)))
    np.testing.assert_allclose(command[0], told.factor * speed * (t + told.delay), rtol=2e-3)


def test_the_adaptive_time_series_learns_a_delay_that_it_was_not_told() -> None:
    """Of 15 ms, told none, from a motion at 1 Hz: within a tick."""
    method = shipped(Known(np.ones(2), np.full(2, 1e-6)))["adaptive_time_series"](1)
    past = [np.zeros((1, 2))] * 15
    for k in range(5000):
        target = np.full((1, 2), 5.0 * np.sin(2.0 * np.pi * TICK * k))
        past.append(method(target, past[-15]))
    w = 2.0 * np.pi
    lead = 5.0 * np.sin(w * TICK * (4999 + 15))
    assert past[-1][0, 0] == pytest.approx(lead, abs=5.0 * w * TICK)


def test_what_is_known_of_the_actuators_is_their_delay_and_gain() -> None:
    x = np.convolve(RNG.standard_normal(3000), np.ones(20))
    record = _record(x, 0.8 * np.roll(x, 12))
    found = known(record)
    np.testing.assert_allclose(found.delay, 12 * TICK)
    np.testing.assert_allclose(found.factor, 1.25, rtol=0.02)


def test_a_run_that_is_lost_has_no_indices_and_does_not_disturb_the_others() -> None:
    def wild(n: int) -> Callable:
        return lambda target, measured: target * np.array([[1.0], [-300.0]])[:n]

    rest, tested, ground = without(frame(), planned_specimen()), actual_specimen(), pulse()
    two = Plants(*(np.repeat(x, 2, axis=0) for x in NOMINAL))
    with np.errstate(all="ignore"):
        both = hybrid(rest, tested, ground, two, np.zeros((len(ground), 2)), wild)
    alone = hybrid(rest, tested, ground, NOMINAL, np.zeros((len(ground), 1)), uncompensated)
    np.testing.assert_allclose(both.node[:, 0], alone.node[:, 0], rtol=1e-9, atol=1e-12)
    right = undivided(frame(), None, ground)
    assert indices(both, 1, right) is None
    assert indices(both, 0, right) is not None


def test_other_folders_and_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no folder .*nowhere; --data DIR has to be a clone of"):
        rths(data=tmp_path / "nowhere")
    with pytest.raises(InputError, match=r"no .*K_matrix\.csv; --data DIR has to be a clone of"):
        rths(data=tmp_path)
    folder = tmp_path / "maRTHS-bmk-RoDeAC/Support_files/FE_Model/REF_SAP2000_Model"
    folder.mkdir(parents=True)
    (folder / "K_matrix.csv").write_text("1,2\n")
    with pytest.raises(InputError, match=r"K_matrix\.csv is another file .* check out commit"):
        rths(data=tmp_path)


def test_the_command_says_what_it_needs(tmp_path: Path, call: Callable) -> None:
    """And ends with status 2, as for every input that is wrong."""
    status, _, err = call("bench", "rths", "--out", str(tmp_path / "out"))
    assert status == 2
    assert "bench rths: needs --data DIR" in err
    status, _, err = call("bench", "rths", "--data", str(tmp_path), "--out", str(tmp_path / "out"))
    assert status == 2
    assert "has to be a clone of github:FermandoisLab/maRTHS-bmk-RoDeAC" in err
    status, _, err = call("bench", "cor", "--data", str(tmp_path), "--out", str(tmp_path / "out"))
    assert status == 2
    assert "--data is an option of bench real and rths only; leave it out" in err


def _public() -> tuple[Material, Substructure, Substructure]:
    material = read(measured_data("maRTHS-bmk-RoDeAC"))
    whole = reference(material)
    return material, whole, without(whole, planned_specimen())


def test_the_public_structure_moves_first_at_the_stated_frequency() -> None:
    """Of 2.29 Hz, the lowest of three storeys (the picture beside the finite-element model)."""
    _, whole, _ = _public()
    flexible = np.linalg.eigvals(np.linalg.solve(whole.stiffness, whole.mass)).real.max()
    assert 1.0 / np.sqrt(flexible) / (2.0 * np.pi) == pytest.approx(2.29, abs=0.005)


def test_the_published_start_of_the_adaptive_compensator_is_found_again() -> None:
    """From structure, coupler, transfer systems, noise and ground motions: 40 numbers, each within
    four standard deviations of the random plants and noise, which are below 1 % of the largest.
    """
    material, _, rest = _public()
    for of in calibration(material, rest, np.random.default_rng(1)).values():
        assert np.abs(of["z"]).max() < 4.0
        assert np.max(of["sigma"]) < 0.01 * np.abs(of["published"]).max()


def test_the_solver_changes_no_printed_digit() -> None:
    """The authors print a tenth; the adaptive compensator, the solver and the exact exponential."""
    material, whole, rest = _public()
    ground = sampled(material.ground["ElCentro"])
    right, readings = undivided(whole, None, ground), noise(len(ground), 0, RNG)
    found = [
        indices(
            hybrid(
                rest, actual_specimen(), ground, NOMINAL, readings, partial(Rodeac, material), f
            ),
            0,
            right,
        )
        for f in (problem.ode4, np.exp)
    ]
    assert found[0] is not None
    assert found[1] is not None
    for key, values in found[0].items():
        np.testing.assert_allclose(values, found[1][key], atol=0.005)
