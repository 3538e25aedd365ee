"""The methods of a scenario: compensation of force and motion, identification; one model a method, told apart by `kind`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from hiltestbed.validation import NotNegative, Positive, Strictly


class NoForceCompensation(Strictly):
    """The numerical model is driven with the measured wrench as it is."""

    kind: Literal["none"] = "none"


class PhaseLead(Strictly):
    """(T1 s + 1)/(T2 s + 1) on the measured wrench."""

    kind: Literal["phase_lead"] = "phase_lead"
    lead: NotNegative | None = Field(default=None, description="T1 [s]; null: sensor.delay + lag")
    lag: Positive = Field(default=0.0005, description="T2 [s]")


class SecondOrderLead(Strictly):
    """The Taylor expansion of exp(delay s) to its second term, over (T2 s + 1)^2."""

    kind: Literal["second_order_lead"] = "second_order_lead"
    lag: Positive = Field(default=0.0005, description="T2 [s]")


class Polynomial(Strictly):
    """Polynomial through the last samples a delay apart, extrapolated by the delay."""

    kind: Literal["polynomial"] = "polynomial"
    order: Annotated[int, Field(ge=1, le=5)] = Field(default=3, description="of the polynomial")


class Reconstruction(Strictly):
    """F_meas + M(x, v) - M(x, v at t - delay), M as identified so far; an axis without an estimate passes the lead."""

    kind: Literal["reconstruction"] = "reconstruction"
    lead: NotNegative | None = Field(default=None, description="T1 of the lead [s]; null: sensor.delay + lag")
    lag: Positive = Field(default=0.0005, description="T2 of the lead [s]")


class SmithPredictor(Strictly):
    """The same with a contact that is given, along the insertion."""

    kind: Literal["smith_predictor"] = "smith_predictor"
    stiffness: Positive = Field(description="of the contact as predicted [N/m]")
    damping: NotNegative = Field(default=0.0, description="[N s/m]")
    lead_rest: bool = Field(default=False, description="what the prediction does not explain passes the phase lead")
    lead: NotNegative | None = Field(default=None, description="T1 of the lead [s]; null: sensor.delay + lag")
    lag: Positive = Field(default=0.0005, description="T2 of the lead [s]")


class VirtualContact(Strictly):
    """A virtual spring and damper along the insertion, beside the measured force."""

    kind: Literal["virtual_contact"] = "virtual_contact"
    stiffness: NotNegative = Field(default=0.0, description="[N/m]")
    damping: NotNegative = Field(description="[N s/m]; the contact's stiffness times the delay gives back what the delay takes")


class CorDesigned(Strictly):
    """A virtual damper along the insertion, designed for a desired coefficient of restitution."""

    kind: Literal["cor_designed"] = "cor_designed"
    stiffness: Positive = Field(description="of the contact that it is designed for [N/m]")
    damping: NotNegative = Field(default=0.0, description="[N s/m]")
    cor: Positive | None = Field(default=None, description="desired; null: that of the contact without a delay")


class DeadZone(Strictly):
    """A force below the width is taken as none."""

    kind: Literal["dead_zone"] = "dead_zone"
    width: NotNegative = Field(description="[N]")


class PassivityControl(Strictly):
    """Time-domain passivity observer and controller."""

    kind: Literal["passivity_control"] = "passivity_control"


class NormalisedPassivity(Strictly):
    """Damping by the normalised power that the delay creates."""

    kind: Literal["normalised_passivity"] = "normalised_passivity"
    gain: NotNegative = Field(default=1.0, description="of the damping force; 1 balances the delay to first order")
    smoothing: Positive = Field(default=0.005, description="time constant of the power's low-pass [s]")


class KnownContact(Strictly):
    """A contact that was identified before."""

    stiffness: Positive = Field(description="[N/m]")
    damping: NotNegative = Field(default=0.0, description="[N s/m]")
    touch: float = Field(default=0.0, description="where along the insertion it is touched first [m]")


class Resynchronised(Strictly):
    """The numerical model at t - delay, driven by the measured wrench as what it is, and predicted from there."""

    kind: Literal["resynchronised"] = "resynchronised"
    contact: KnownContact | None = Field(default=None, description="null: nothing is known of it, it is identified as it is met")
    delay: Literal["known", "estimate"] = Field(default="known", description="estimate: correct sensor.delay by the instant of first touch")
    blending: Positive = Field(default=0.002, description="time constant with which a corrected prediction reaches the platform [s]")


class NoMotionCompensation(Strictly):
    """The platform is commanded with the pose alone."""

    kind: Literal["none"] = "none"


class Feedforward(Strictly):
    """Velocity and acceleration feed-forward of the platform's servo."""

    kind: Literal["feedforward"] = "feedforward"


class InverseModel(Strictly):
    """The commanded pose passes the inverse of the platform's response, (1 + T s)(1 + 2 zeta s/w + s^2/w^2), cut after an order."""

    kind: Literal["inverse_model"] = "inverse_model"
    order: Annotated[int, Field(ge=1, le=3)] = Field(default=2, description="highest derivative of the command that is used")
    bandwidth: Positive = Field(default=40.0, description="w/2 pi of the platform [Hz]")
    damping_ratio: Positive = Field(default=1.0, description="zeta of the platform")
    time_constant: NotNegative = Field(default=0.0, description="T, of what makes its response third-order [s]")


class AdaptiveTimeSeries(Strictly):
    """The commanded pose passes a0 x + a1 x' + a2 x'', fitted to what the platform made of its last commands."""

    kind: Literal["adaptive_time_series"] = "adaptive_time_series"
    window: Positive = Field(default=1.0, description="memory of the fit [s]")
    delay: NotNegative = Field(default=0.008, description="of the platform as believed at the start [s]")


class Admittance(Strictly):
    """Feed-forward, and a platform that yields along the insertion where the contact as identified would press harder than a limit."""

    kind: Literal["admittance"] = "admittance"
    limit: Positive = Field(description="of the contact force [N]")
    speed: Positive = Field(default=0.1, description="with which the platform yields at most [m/s]")


class ContactCorrection(Strictly):
    """The force is corrected for where the platform is not: + k (x_cmd - x_act) + c (v_cmd - v_act), k and c as identified."""

    kind: Literal["contact_correction"] = "contact_correction"


ForceCompensation = Annotated[
    NoForceCompensation
    | PhaseLead
    | SecondOrderLead
    | Polynomial
    | Reconstruction
    | SmithPredictor
    | VirtualContact
    | CorDesigned
    | DeadZone
    | PassivityControl
    | NormalisedPassivity
    | Resynchronised,
    Field(discriminator="kind"),
]
MotionCompensation = Annotated[
    NoMotionCompensation | Feedforward | Admittance | InverseModel | AdaptiveTimeSeries | ContactCorrection, Field(discriminator="kind")
]


class Compensation(Strictly):
    """What is done against the delays of the loop."""

    force: ForceCompensation = Resynchronised()
    motion: MotionCompensation = Feedforward()


class NoIdentification(Strictly):
    """Stiffness and damping are not estimated."""

    kind: Literal["none"] = "none"


class Rls(Strictly):
    """Recursive least squares of k and c on each axis, in contact alone, with the pose at the time the force was felt."""

    kind: Literal["rls"] = "rls"
    forgetting: Annotated[float, Field(gt=0, le=1)] = Field(default=1.0, description="forgetting factor a tick; 1: none")
    delay: Literal["known", "estimate"] = Field(default="known", description="estimate: sensor.delay is found from the instant of touch")


class RlsRaw(Strictly):
    """The same on the force as it is read, beside the pose of the same tick."""

    kind: Literal["rls_raw"] = "rls_raw"
    forgetting: Annotated[float, Field(gt=0, le=1)] = Field(default=1.0, description="forgetting factor a tick; 1: none")


class RlsLead(Strictly):
    """The same on the force after the first-order phase lead."""

    kind: Literal["rls_lead"] = "rls_lead"
    forgetting: Annotated[float, Field(gt=0, le=1)] = Field(default=1.0, description="forgetting factor a tick; 1: none")
    lag: Positive = Field(default=0.0005, description="T2 of the lead [s]; T1 is sensor.delay + T2")


class Kalman(Strictly):
    """Adaptive Kalman filter of k, c and an intercept that wander, on aligned samples."""

    kind: Literal["kalman"] = "kalman"
    wander: NotNegative = Field(default=1e-6, description="part of an innovation's correction that is taken for wandering")


class HuntCrossley(Strictly):
    """Single-stage fit of F = k x^n (1 + alpha v), on aligned samples."""

    kind: Literal["hunt_crossley"] = "hunt_crossley"


class Instrumental(Strictly):
    """Batch least squares with instrument variables, on aligned samples: the yardstick where the pose is noisy."""

    kind: Literal["instrumental"] = "instrumental"
    lag: Annotated[int, Field(ge=1)] = Field(default=2, description="ticks by which the instruments are older than the samples")


Identification = Annotated[NoIdentification | Rls | RlsRaw | RlsLead | Kalman | HuntCrossley | Instrumental, Field(discriminator="kind")]
