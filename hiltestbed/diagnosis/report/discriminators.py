"""Rules for the experiment that tells two effects apart, with a dataset's own numbers.

Each rule is for a pair of effects, one of `first` and one of `second`, and states the runs and how
the two differ in them. Confounded
pairs and what breaks them: Section 5 of the literature (standard set of experiments: free flight,
sweep in air, known springs, ladder of speeds, offsets, press and hold); equations of the contact:
k_app = k cos w tau + c w sin w tau, c_app = c cos w tau - (k/w) sin w tau.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hiltestbed.diagnosis.report.facts import Facts, rounded

Plan = tuple[str, tuple[Mapping[str, Any], ...]]
# chosen: [rad] w tau above which a lag and a delay differ: the lag loses w^2 tau^2 = 12 % of the
# stiffness
LAG_PHASE = 0.35


@dataclass(frozen=True)
class Discriminator:
    """`plan(facts)` gives the text and the runs that separate an effect of `first` from one of
    `second`.
    """

    first: frozenset[str]
    second: frozenset[str]
    plan: Callable[[Facts], Plan]

    def separates(self, effect: str, rival: str) -> bool:
        """Whether the rule separates two different effects."""
        pairs = ((effect, rival), (rival, effect))
        return effect != rival and any(a in self.first and b in self.second for a, b in pairs)


def springs_for_delay(f: Facts) -> Plan:
    low, high = f.new_springs()
    late = f.estimate("sensor.delay delay", "log.skew delay", "platform.delay delay", other=f.tick)
    late = max(late, 1e-5)
    text = (
        f"Run the same approach ({f.fast:g} m/s) on two other known springs, k = {low:g} and "
        f"{high:g} N/m, damper unchanged. A delay of {1e3 * late:.3g} ms changes the apparent "
        f"damping by -k tau = {-low * late:.3g} and {-high * late:.3g} N s/m, a damper by the same "
        "amount on both. Do not vary the masses: sqrt(mu) ln e = (pi/2)(k tau - c)/sqrt(k) holds "
        "for every mass, so that a mass ladder separates nothing."
    )
    return text, tuple({"mechanism.contact.stiffness": k} | f.at_speed(f.fast) for k in (low, high))


def fast_contact_for_lag(f: Facts) -> Plan:
    tau = f.estimate("sensor.lag time_constant", "sensor.delay delay", other=f.tick)
    stiff = rounded(f.mass * (LAG_PHASE / tau) ** 2)
    light = rounded(f.stiffness * (tau / LAG_PHASE) ** 2)
    speed = rounded(min(f.fast, f.peak / math.sqrt(stiff * f.mass)))
    text = (
        f"A lag and a pure delay of {1e3 * tau:.3g} ms differ only where w tau > 0.3. Run a "
        f"contact of that speed: a known spring of k >= {stiff:g} N/m at {speed:g} m/s (peak force "
        f"about {speed * math.sqrt(stiff * f.mass):.3g} N), or the present spring with masses that "
        f"reduce to {light:g} kg. There the lag reads the force "
        f"{100 * (1 - 1 / math.sqrt(1 + LAG_PHASE**2)):.0f} % low and the delay does not. Without "
        "a contact: tap the sensor with a hammer and look at the edge: after a delay it is steep."
    )
    return text, ({"mechanism.contact.stiffness": stiff} | f.at_speed(speed),)


def known_weight(f: Facts) -> Plan:
    load = rounded(f.peak)
    factor = f.estimate("sensor.gain factor", other=1.05)
    text = (
        f"Set a known weight of {load:g} N ({load / 9.81:.2g} kg) on the sensor, no contact: a "
        f"scale error of {factor:.4g} reads {load * factor:.4g} N, a different spring reads "
        f"{load:g} N. The loop alone cannot separate them: momentum balances with the force as it "
        "is measured. A known spring instead of the mechanism does the same."
    )
    return text, ()


def axial_weight(f: Facts) -> Plan:
    load = rounded(f.peak)
    text = (
        f"Load the sensor along z alone with a weight of {load:g} N, no contact, and again in "
        f"contact with the port tilted by 2 degrees both ways ({f.slow:g} m/s). Cross-talk shows "
        "the same part of fz on the lateral axis in all of them; a tilted surface shows nothing "
        "under the weight and follows the tilt; friction follows the direction of sliding."
    )
    return text, tuple({"approach.attitude_deg": [0.0, a, 0.0]} for a in (-2.0, 2.0))


def both_ways_sideways(f: Facts) -> Plan:
    side = rounded(0.3 * f.fast)
    text = (
        f"Run two approaches at {f.fast:g} m/s that slide sideways at +{side:g} and -{side:g} "
        f"m/s, and one that does not slide. Friction "
        "changes sign with the sliding and is gone without it; cross-talk and a tilt do not change."
    )
    return text, tuple({"approach.velocity": [v, 0.0, f.fast]} for v in (side, -side, 0.0))


def rebound(f: Facts) -> Plan:
    late = f.estimate("log.skew delay", "sensor.delay delay", other=f.tick)
    factor = math.exp(0.5 * math.pi * f.frequency * late)
    stiff = rounded(4 * f.stiffness)
    record = (
        "Record wrench_comp as well (what the numerical model is driven with), and run"
        if "wrench_comp" in f.lacking
        else "Run"
    )
    text = (
        f"{record} the same approach ({f.fast:g} m/s) on the present spring and on one of "
        f"{stiff:g} N/m, and compare the rebound speeds of pose_cmd. A delay, jitter or lag of "
        f"{1e3 * late:.3g} ms inside the loop raises the coefficient of restitution by exp(pi w "
        f"tau/2) = {factor:.4f} and {math.exp(math.pi * f.frequency * late):.4f}; a record that is "
        "merely stamped late leaves it as it is on both."
    )
    return text, (f.at_speed(f.fast), f.with_spring(stiff) | f.at_speed(f.fast))


def repeated_edges(f: Facts) -> Plan:
    late = f.estimate("sensor.jitter sigma", "sensor.delay delay", other=f.tick)
    text = (
        "Tap the sensor with a hammer 100 times and log the tap by a second sensor on the same "
        f"clock at {1 / f.tick:g} Hz. The edge of wrench_meas follows that of the tap: with jitter "
        f"its lateness scatters from tap to tap, here by {1e3 * late:.3g} ms; after a delay it is "
        "the same every time, after a lag the edge is less steep."
    )
    return text, ()


def speed_ladder(f: Facts) -> Plan:
    if f.captured:
        return cycles(f)
    speeds = tuple(dict.fromkeys(rounded(v) for v in (0.25 * f.slow, f.slow, f.fast, 3.0 * f.fast)))
    listed = ", ".join(f"{v:g}" for v in speeds)
    text = (
        f"Run a ladder of speeds on the present spring: {listed} m/s. The loop of force over "
        "penetration separates them: dry friction keeps its width in newtons at every speed, a "
        "preload has no width but lifts both branches, a viscous damper's grows with the speed, a "
        "Hunt-Crossley damper's with the speed times the penetration, a relaxing branch's with "
        "neither at the slow end. A power law shows as a stiffness that grows with the peak force, "
        "a stop as a knee at one penetration."
    )
    return text, tuple(f.at_speed(v) for v in speeds)


def cycles(f: Facts) -> Plan:
    text = (
        "Cycle the captured mechanism at 0.05, 0.2, 1 and 4 Hz with amplitudes of "
        f"{1e3 * f.depth:.2g} and {250 * f.depth:.2g} mm, three cycles each. The loop of force "
        "over displacement separates them: dry friction keeps its width in newtons at every rate "
        "and amplitude, a damper's grows with both, a relaxing branch's is widest at one rate, "
        "play shows as a flat stretch of one width at each reversal, a saturation of the sensor as "
        "a flat top at one force that a weight on the sensor shows too."
    )
    return text, ()


def springs_for_frame(f: Facts) -> Plan:
    low, high = f.new_springs()
    frame = f.estimate("frame.compliance stiffness", other=20.0 * f.stiffness)
    text = (
        f"Run known springs of k = {low:g} and {high:g} N/m. A frame of {frame:.3g} N/m in series "
        f"takes {100 * low / (low + frame):.2g} % off the one and "
        f"{100 * high / (high + frame):.2g} % off the other; a wrong factor takes the same part "
        "off both, or nothing where the springs replace the mechanism that is softer; a preload "
        "adds the same force to both. Or mount a second displacement sensor "
        "across the mechanism: it sees the penetration without the frame."
    )
    return text, tuple(f.with_spring(k) for k in (low, high))


def touch_detector(f: Facts) -> Plan:
    low, high = f.new_springs()
    preload = f.estimate("contact.preload force", other=0.02 * f.peak)
    offset = f.estimate("contact.touch_offset offset", other=preload / f.stiffness)
    text = (
        "Detect the touch by itself: an electrical contact across the ports, read at "
        f"{1 / f.tick:g} Hz, at {f.slow:g} m/s. An offset of {1e3 * offset:.3g} mm moves the "
        "touch; a preload, dry friction and a compliant frame do not. Another speed does not help; "
        f"two springs do: at k = {low:g} and {high:g} N/m the offset shifts the force by "
        f"{low * offset:.3g} and {high * offset:.3g} N, a preload by the same."
    )
    return text, tuple(f.with_spring(k) | f.at_speed(f.slow) for k in (low, high))


def press_and_hold(f: Facts) -> Plan:
    kinds = "contact.relaxation time_constant", "sensor.highpass time_constant"
    time = f.estimate(*kinds, other=0.5)
    text = (
        f"Press to {1e3 * f.depth:.2g} mm and hold the pose for {rounded(5 * time):g} s, then hold "
        f"a dead weight of {rounded(0.5 * f.peak):g} N on the sensor as long. A relaxing contact "
        "creeps to a lower, steady force under the held pose and not under the weight; a leaking "
        "charge decays to zero under both and swings through zero when unloaded; a wrong stiffness "
        "or damping does neither."
    )
    return text, ()


def long_free(f: Facts) -> Plan:
    text = (
        "Read the sensor for 60 s without contact, from the moment it is tared, at three "
        f"attitudes, and for 60 s more under a weight of {rounded(0.5 * f.peak):g} N. A bias "
        "stays, a drift grows in proportion to the time with and without the weight (1 N/s shows "
        f"within {max(20 * f.noise, 1e-3):.2g} s above the noise of {f.noise:.2g} N), a leaking "
        "charge lets the weight's reading decay and shows nothing without it, a weight that was "
        "not tared follows the attitude, a tone stands in the spectrum."
    )
    return text, ({"approach.gap": 0.2, "approach.velocity": [0.0, 0.0, 0.0]},)


def weights_ladder(f: Facts) -> Plan:
    width = f.largest("sensor.deadzone width", "loop.deadzone width", least=4 * f.noise)
    limit = f.estimate("sensor.saturation limit", other=f.peak)
    loads = ", ".join(
        f"{rounded(w):g}"
        for w in sorted(
            (0.3 * width, 0.7 * width, 1.5 * width, 0.5 * limit, 0.9 * limit, 1.2 * limit)
        )
    )
    text = (
        f"Load the sensor with known weights, no contact: {loads} N, and compare the "
        f"readings{f.log('wrench_comp')}. A dead zone of the sensor reads zero below its width, "
        "one of the loop shows in wrench_comp alone, a saturation reads its limit, a wrong gain "
        "the same factor at every weight, a map of the calibration a curve. A law of the contact "
        "(a power law, a stop, a stiffness, play, a preload, an offset of the touch) shows in none "
        "of them."
    )
    return text, ()


def three_weights(f: Facts) -> Plan:
    load = rounded(f.peak)
    angles: Sequence[float] = f.estimates.get("sensor.rotation", {}).get(
        "angles_deg", (0.0, 0.0, 0.0)
    )
    angle = max(abs(float(a)) for a in angles[:2]) or 2.0
    side = load * math.sin(math.radians(angle))
    text = (
        f"Load the sensor with a weight of {load:g} N along z, then along x and along y, without "
        f"contact. A sensor that is rotated by {angle:.2g} deg about x or y reads {side:.3g} N on "
        "a lateral axis under the first and as much with the other sign on z under the second, and "
        "its torques turn with the forces; cross-talk has its own ratio for each pair of axes and "
        "leaves the torques; a bias is the same under all; a wrong gain leaves the other axes at "
        "zero. Everything that needs the contact shows nothing here: a tilted port (misalignment), "
        "friction of the surfaces, a compliant frame, stiffness, damping."
    )
    return text, ()


def beyond_the_data(f: Facts) -> Plan:
    slow, fast = rounded(0.25 * f.slow), rounded(2.0 * f.fast)
    runs = (
        f"Cycle the captured mechanism with amplitudes of {500 * f.depth:.2g} and "
        f"{2e3 * f.depth:.2g} mm at 0.05 and 4 Hz"
        if f.captured
        else f"Run at {slow:g} and {fast:g} m/s with the present spring"
    )
    text = (
        f"{runs}, outside the penetrations and rates of these data. A power law, a hard stop, a "
        "damper or dry friction that is the cause predicts these runs with its present estimates. "
        f"The curves of a map hold only up to {1e3 * f.depth:.2g} mm: if the force follows them, "
        "the estimates of the simpler law fail here."
    )
    return text, () if f.captured else (f.at_speed(slow), f.at_speed(fast))


def travel_in_air(f: Facts) -> Plan:
    width = f.largest("platform.backlash width", "contact.backlash width", least=5e-5)
    text = (
        f"Move the platform in air, ports apart, along {f.axis} in slow triangles of "
        f"{1e3 * rounded(20 * width):g} mm and compare pose_act "
        "with pose_cmd. A scale error of the platform is a slope, its play (backlash) a distance "
        "that changes at each reversal; a touch "
        "that is offset, play in the latch and everything else of the contact shows nothing in air."
    )
    return text, ()


def sweeps_of_a_drive(f: Facts) -> Plan:
    top = min(0.2 / f.tick, 100.0)
    text = (
        f"Sweep the platform in air along {f.axis} from 0.5 to {rounded(top):g} Hz in 60 s, with "
        f"amplitudes of {1e3 * f.stroke:g}, {250 * f.stroke:g} and {25 * f.stroke:g} mm. A lag and "
        "a mode have the same gain and phase at every amplitude; a drive that works against dry "
        "friction responds less the smaller it is, holds at each reversal, and settles on the "
        "command again if its controller integrates; play (backlash) keeps a constant distance to "
        "the command, and stiction (platform.friction) moves in jumps."
    )
    return text, ()


def wider_sweep(f: Facts) -> Plan:
    top = min(0.4 / f.tick, 200.0)
    text = (
        f"Sweep the platform in air along {f.axis} from 0.5 to {rounded(top):g} Hz in 60 s with an "
        f"amplitude of {1e3 * f.stroke:g} mm. A lag, a delay or a mode predicts gain and phase of "
        "the whole sweep with its present estimates; where it does not, the response is of a "
        "higher order, as platform.response has it from its step."
    )
    return text, ()


def sensor_alone(f: Facts) -> Plan:
    text = (
        f"Load the sensor by itself, no contact: known weights up to {rounded(f.peak):g} N along "
        "each axis, held for 60 s, and a tap with a hammer. What the sensor does is in these "
        "readings as well (gain, axes, offset, decay, edge); what another part of the loop does is "
        "not."
    )
    return text, ()


def platform_alone(f: Facts) -> Plan:
    sweep, _ = air_sweep(f)
    return (
        f"{sweep} What another part of the loop does needs the contact and is not in this sweep.",
        (),
    )


def model_alone(f: Facts) -> Plan:
    push = rounded(f.peak * math.pi / f.frequency / 2)
    text = (
        f"Drive the numerical model by itself with a computed pulse of {push:g} N s, the rig "
        f"switched off. Its ports part at {push / f.mass:.4g} m/s if the masses are those "
        "believed, on a straight line, from the tick of the pulse on: what departs from this is "
        "due to the model; if nothing does, the other part of the loop is the cause."
    )
    return text, ()


def air_sweep(f: Facts) -> Plan:
    top = min(0.2 / f.tick, 100.0)
    late = f.estimate("platform.delay delay", other=2 * f.tick)
    text = (
        f"Sweep the platform in air, no contact: {f.axis} amplitude {1e3 * f.stroke:g} mm from 0.5 "
        f"to {rounded(top):g} Hz in 60 s, and read pose_act over pose_cmd. A pure delay of "
        f"{1e3 * late:.3g} ms has gain 1 and a phase of {rounded(360 * late):g} deg a hertz; a "
        "second-order lag loses gain past its bandwidth; a mode has a peak; a speed limit shows as "
        f"a triangle that depends on the amplitude (repeat with {250 * f.stroke:g} mm)."
    )
    return text, ()


def reversals(f: Facts) -> Plan:
    width = f.largest("platform.backlash width", "platform.friction stick", least=5e-5)
    text = (
        f"Move the platform in air in slow triangles of {1e3 * rounded(20 * width):g} mm at "
        f"{rounded(20 * width):g} m/s and read pose_act over pose_cmd. Play holds the pose for "
        f"{1e3 * width:.2g} mm at each reversal and then follows at a constant distance; stiction "
        "goes in steps all along; a scale error is a slope; a delay or a lag is gone at half the "
        "speed."
    )
    return text, ()


def bodies_absolute(f: Facts) -> Plan:
    heavy = rounded(4 * f.target)
    text = (
        "Log the absolute pose of each body of the numerical model: only the relative one was "
        f"recorded, in which both bodies' masses are one reduced mass of {f.mass:.4g} kg. Without "
        f"that log, repeat one run with a target of {heavy:g} kg: an error of the chaser's mass "
        "keeps its part of the relative acceleration, one of the target's fades to a quarter."
    )
    return text, ({"spacecraft.target.mass": heavy} | f.at_speed(f.fast),)


def off_centre(f: Facts) -> Plan:
    text = (
        "Touch off centre: offsets of -0.05, 0 and 0.05 m along x and along y. An error of the "
        "inertia scales the rotation that the offset makes and is nothing at the centre; a port in "
        "another place adds the same rotation to all; a mass error shows in translation alone."
    )
    return text, tuple({"approach.offset": o} for o in ([-0.05, 0.0], [0.05, 0.0], [0.0, 0.05]))


def long_after(f: Facts) -> Plan:
    tone = f.estimate("dynamics.appendage frequency", other=0.3)
    text = (
        f"Record {rounded(max(4 / tone, 2.0)):g} s of free flight after the contact. An appendage "
        f"on a spring makes pose_cmd oscillate at about {tone:.2g} Hz without a force; a force "
        "that resists the motion (dynamics.force) bends it until it rests; a wrong mass leaves "
        "straight lines."
    )
    return text, ({"duration": rounded(max(4 / tone, 2.0)) + 1.0},)


def other_rate(f: Facts) -> Plan:
    rate = rounded(2 / f.tick, 3)
    text = (
        f"Run the loop at {rate:g} Hz on the same contact. The excess of an explicit integrator "
        "and whole ticks of transport halve with the tick (the integrator acts as one tick, so "
        "compare their size: a step delay is a whole number of ticks and shows as a shift of "
        "pose_cmd against wrench_comp at the edge of the force); a mass error stays."
    )
    return text, ({"rate": rate, "physics_rate": 2 * rate},)


def tap(f: Facts) -> Plan:
    text = (
        "Tap the sensor's frame, then the platform's port, with a hammer while all stands still "
        "and record both at the full rate: the frame's mode rings in the force after the first, "
        "the platform's in pose_act after the second. A hum is there before the tap too; a "
        "compliant frame, a leaking charge, an adhesion, a damper, a lag or a delay of the sensor "
        "rings in neither."
    )
    return text, ()


def slow_parting(f: Facts) -> Plan:
    slow = rounded(0.25 * f.slow)
    text = (
        f"Press lightly and part slowly, at {slow:g} m/s. An adhesion pulls while pz > 0 and ends "
        "with the contact, whatever the speed; the tail of a leaking charge stays after the "
        "contact and shrinks with the impulse; dry friction pulls all the way up, a damper not at "
        "this speed."
    )
    return text, (f.at_speed(slow),)


def rule(first: str, second: str, plan: Callable[[Facts], Plan]) -> Discriminator:
    return Discriminator(frozenset(first.split()), frozenset(second.split()), plan)


def among(effects: str, plan: Callable[[Facts], Plan], others: str = "") -> Discriminator:
    """The rule for any two of ``effects``, and for one of these and one of the ``others``."""
    return rule(effects, f"{effects} {others}", plan)


_LATE = (
    "sensor.delay sensor.lag platform.delay platform.lag dynamics.step_delay dynamics.integrator"
)
_LOSS = "contact.damping contact.hunt_crossley contact.dry_friction"
_TOUCH = "contact.touch_offset contact.preload"
_SOFT = "contact.stiffness contact.power_law contact.relaxation"
_CURVED = "contact.power_law contact.hard_stop"
_DRIVEN = "platform.lag platform.delay platform.mode"
_TOUCHING = (
    "contact.misalignment contact.surface_friction frame.compliance "
    "contact.stiffness contact.damping"
)
_LATCHED = "contact.touch_offset contact.backlash"

RULES = (
    rule("log.skew", "sensor.delay sensor.lag sensor.jitter dynamics.step_delay", rebound),
    rule("sensor.lag", "sensor.delay", fast_contact_for_lag),
    rule("sensor.jitter", "sensor.delay sensor.lag", repeated_edges),
    rule("contact.damping", f"{_LATE} log.skew", springs_for_delay),
    rule("sensor.gain", f"{_SOFT} contact.damping frame.compliance", known_weight),
    among(_TOUCH, touch_detector),
    rule("contact.touch_offset", "frame.compliance contact.dry_friction", touch_detector),
    rule("frame.compliance", f"{_SOFT} contact.preload", springs_for_frame),
    rule(
        "contact.surface_friction",
        "sensor.crosstalk contact.misalignment sensor.bias",
        both_ways_sideways,
    ),
    rule("sensor.rotation", f"sensor.crosstalk sensor.bias sensor.gain {_TOUCHING}", three_weights),
    rule(
        "sensor.crosstalk",
        "contact.misalignment sensor.gain sensor.bias dynamics.port_offset",
        axial_weight,
    ),
    rule(
        "contact.relaxation",
        f"contact.stiffness sensor.highpass sensor.lag {_LOSS}",
        press_and_hold,
    ),
    rule("contact.adhesion", f"sensor.highpass sensor.bias {_LOSS}", slow_parting),
    rule(
        "sensor.deadzone",
        f"loop.deadzone contact.power_law contact.preload {_LATCHED}",
        weights_ladder,
    ),
    rule("sensor.map", f"sensor.gain sensor.saturation sensor.deadzone {_CURVED}", weights_ladder),
    rule("sensor.saturation", f"{_CURVED} contact.stiffness sensor.gain", weights_ladder),
    among("sensor.bias sensor.drift sensor.hum sensor.highpass", long_free),
    rule(
        "frame.mode",
        "platform.mode frame.compliance contact.adhesion contact.damping sensor.highpass "
        "sensor.hum sensor.lag sensor.delay",
        tap,
    ),
    among(f"{_LOSS} contact.preload", speed_ladder),
    among(_CURVED, speed_ladder, f"{_TOUCH} contact.stiffness"),
    rule("contact.map", f"{_CURVED} contact.damping contact.dry_friction", beyond_the_data),
    rule(_LATCHED, "platform.scale platform.backlash", travel_in_air),
    rule("platform.drive", f"{_DRIVEN} platform.backlash platform.friction", sweeps_of_a_drive),
    rule("platform.response", _DRIVEN, wider_sweep),
    among(
        "platform.backlash platform.friction",
        reversals,
        "platform.scale platform.delay platform.lag",
    ),
    among(f"{_DRIVEN} platform.speed_limit", air_sweep, "platform.scale"),
    among("dynamics.appendage dynamics.force", long_after, "dynamics.mass"),
    among("dynamics.inertia dynamics.port_offset", off_centre, "dynamics.mass"),
    among("dynamics.integrator dynamics.step_delay", other_rate, "dynamics.mass"),
)

# where no rule applies and two effects act on different links: the link that can be tested by
# itself, in this order
ALONE: dict[str, Callable[[Facts], Plan]] = {
    "log": rebound,
    "platform": platform_alone,
    "sensor": sensor_alone,
    "compensation": weights_ladder,
    "dynamics": model_alone,
}

BY_LINK: dict[str, Callable[[Facts], Plan]] = {
    "platform": air_sweep,
    "contact": speed_ladder,
    "sensor": weights_ladder,
    "compensation": weights_ladder,
    "dynamics": bodies_absolute,
    "log": rebound,
}
