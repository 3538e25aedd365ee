"""The tuning constants that several stages of the diagnosis share, each with its unit and where it
comes from.

A *derived* number follows from the equation that is named. A *calibrated* one was set on data sets
of the independent rig (``hiltestbed bench diagnosis``) and must be set again when the figure that
it is compared with changes. A *chosen* one is neither. Chi-square is in units of the noise.
Constants that a single module uses stand in that module.
"""

from __future__ import annotations

import math

# Detection and selection: thresholds on the reduction of chi-square
# calibrated: detection threshold of one effect, beyond its penalty; the best wrong one reached 3.6
# on 460 healthy rigs
DETECTION = 30.0
# derived: for each parameter, by the Bayesian information criterion for some thousand independent
# samples
PENALTY = math.log(1000.0)


# Timing
# derived: [rows] two channels, each stamped up to a row off; a record with more is refused
MAX_STAMP_SHIFT_ROWS = 2.25
# chosen: [rows] two instants, each up to half a tick off, and the error due to noise
MAX_UNNAMED_DELAY_ROWS = 1.05

# Noise
MIN_FREE_ROWS = 30  # chosen: rows away from contacts from which a noise floor is estimated
MIN_POSE_NOISE = 1e-9  # chosen: [m, rad] floor of a pose without noise: round-off of the file
# calibrated: [m, rad] difference between integrators of one step size, practice rig and this one
DYNAMICS_FLOOR = 2e-6
# chosen: share of the force noise: difference between two implementations of one filter
COMPENSATION_FLOOR = 0.05
# chosen: rows of a computed channel that count as one sample, since its errors are smooth
CORRELATED_ROWS = 50

# Noise of the force, from free flight
# derived: rows over all runs: with six channels a correlation is then known to 0.03
MIN_NOISE_ROWS = 150
# derived: standard deviations; one of 15,000 white records exceeds it by chance
SIGNIFICANCE_SIGMA = 4.0
SIGNIFICANCE_LEVEL = 3e-5  # derived: the same as a probability, for sums of a few squares

# Adequacy: goodness of fit
# chosen: samples whose mean is tested as well: a smooth misfit far below the noise shows in it
BLOCK_ROWS = 8
# measured: share of the signal: another sub-stepping, another interpolation; a contact of a hundred
# steps is integrated to 0.1 to 0.24 %
MODEL_ERROR = 1e-3

# The path on which contact and sensor are replayed
# chosen: [m] converts attitude noise to noise of the contact point: size of tips and rods
LEVER_ARM = 0.1
# chosen: copies of a path for its noise: the spread to a third, before it is smoothed over rows
PERTURBED_COPIES = 4
# chosen: window of the Savitzky-Golay filter, order 3, where only a noisy pose is available
SMOOTHING_ROWS = 31

# Gain on left-out runs
# chosen: share of the residual on left-out runs (geometric mean) by which a further cause has to
# lower it
MIN_HELDOUT_GAIN = 0.02

# Parts of an explanation that hold
MIN_EXPLAINED = 0.3  # chosen: share of the departure on left-out runs, below which no part is named
# chosen: share of the residual on left-out runs by which each named cause has to lower it
MIN_HELDOUT_GAIN_IN_PART = 0.05
MIN_RUN_SHARE = 0.8  # chosen: share of the runs that have to agree

# Two interpretations of one facility
# derived: chi-square: choice between two equally likely interpretations
INTERPRETATION_PENALTY = 2.0 * math.log(2.0)

# Laws learned where no effect has a name for what departs
# chosen: weight of a squared second difference, of the mean square response of a knot; for knots
# without data
KNOT_SMOOTHING = 1e-4
# chosen: reaches of a slider that are tried first, from a fiftieth of the travel to half of it
REACHES_TRIED = 7
REACH_REFINEMENTS = 5  # chosen: refinements of that reach
MAX_EQUATION_ERROR = 0.05  # chosen: share of a curve's rms that an equation may leave
# derived: cosine above which a named effect removes four fifths of the square of what a law removes
MIN_RESEMBLANCE = 0.9
