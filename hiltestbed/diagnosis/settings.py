"""Every number of the diagnosis that is chosen, with where it comes from.

A *derived* number follows from an equation that is named. A *calibrated* one was set on sets of the independent rig
(``hiltestbed bench diagnosis``) and must be set again when what it is compared with changes. Chi-square is in units of the noise.
"""

from __future__ import annotations

import math

# Detection: is there a departure at all?
DETECTION = 30.0  # calibrated: what one effect must take off chi-square, its penalty paid; the best wrong one took 3.6 in 460 healthy rigs
SELECTION = 100.0  # calibrated: what a further cause must take off where the causes so far leave noise already
SELECTION_INADEQUATE = 10.0  # calibrated: and where they do not; a factor of 150 in likelihood
AMBIGUITY = 12.0  # derived: a likelihood ratio of 1 : 400, below which two hypotheses of one size cannot be told apart
PENALTY = math.log(1000.0)  # derived: Bayesian information criterion of some thousand independent samples, a parameter
MOST_CAUSES = 3  # on one link: a fourth was never found right on a link of the benchmark
MOST_CAUSES_IN_PART = 5  # that are tried where the ones found leave more than noise
MOST_RIVALS = 2  # that are listed beside a cause: a set of more does not name anything

# Search
WORTH_A_FIT = 8.0  # derived: chi-square of one parameter at 99.5 %: a linearised gain below it is noise
BEAM = 5  # first causes that a second one is sought for
PARTNERS = 6  # second causes that are fitted beside each
SIMILAR = 3  # hypotheses of one effect (axes, variants) that are fitted
SINGLES = 40  # first causes that are fitted
UNDERRATED = 10.0  # times its linearised gain, that a hypothesis may take off: the most was 3.5, of 553 fits on 18 sets of the rig
VARIANT = 0.3  # of what the best takes off chi-square: where one reading of an effect takes less, the others are not fitted
CLOSE_BY = 60.0  # of chi-square: hypotheses this near to the best are fitted to the end, others as long as they may come so near
NEAR_AN_END = 0.1  # of the range of a parameter: nearer to its end it is tried whether the end itself does as well
ROUNDED_OFF = 1e-4  # of what the causes take off chi-square: what blocks of rows may shift it by; ten times what was seen (1.2e-5)
FAR = 1e6  # sigma: a prediction that left the finite numbers

# Noise
FREE_ROWS = 30  # from which a noise floor is read
UNEVEN = 3.0  # the most that the noise of one axis of translation exceeds another's: a platform that moves in jumps looks noisy
NO_POSE_NOISE = 1e-9  # [m, rad] floor of a pose that carries no noise: round-off of the file
NO_FORCE_NOISE = 1e-6  # of the peak force: floor of a force that carries no noise
ARM_UNKNOWN = 2e-6  # [m] arm of the peak force that makes the floor of a torque: where in the overlap the force acts is known to that
DYNAMICS_FLOOR = 2e-6  # [m, rad] what integrators of one step size differ by, practice rig against this one
DYNAMICS_BETWEEN = 2e-6  # [m, rad] derived: a h^2/8 that a line between rows misses, at both ends; 8 m/s^2: 0.1 m/s, contacts of 40 ms
COMPENSATION_FLOOR = 0.05  # of the force noise: what two realisations of one filter may differ by
CORRELATED = 50  # rows of a computed channel that count as one: its errors are smooth
TAIL = 0.15  # [s] after the last contact that a search looks at: where leaks and rings show

# Noise of the force, from free flight
ENOUGH_FREE = 150  # rows of all runs: six channels of as many know a correlation to 0.03
WHITE_KNOWN = 1.5  # simulated: white noise by third differences of n rows is known to this over the root of n
SIGNIFICANT = 4.0  # derived: standard deviations of chance; one of 15,000 white records is taken for more
BY_CHANCE = 3e-5  # derived: the same as a probability, where what is compared is a sum of a few squares
HEAVY = 3  # samples beyond four standard deviations, more than normal ones have
KNEE = 3.0  # [sigma] from which a sample of noise with outliers counts by its logarithm
SHARE_SHOWS = 0.3  # of the noise's variance, that a share of the reading has to add at its largest readings

# Adequacy: is what is left noise?
BLOCK = 8  # samples whose mean is judged, too: a smooth misfit far below the noise shows there
SPREAD = 4.5  # standard deviations that a figure may lie off: of some 30 figures, one in 5000 sets does
FLOOR_ERROR = 0.08  # derived: of a variance by the median of third differences, 2.3 of which count as one, of FLOOR_ROWS
FLOOR_ROWS = 1500
MODEL_ERROR = 1e-3  # of the signal: another sub-stepping, another interpolation
COMPUTED_LEFT = 0.01  # of the departure of a computed channel that an explanation may leave
LED_NOISE = 1.7  # times the led noise, up to which a residual of the compensation may be noise of the record
RECORD_LEFT = 0.2  # of what a late record does to the compensation, that its interpolation between rows may leave

# A delay that varies from sample to sample
SHAKEN = 1.2  # times the noise: where it shows
SAME_AGAIN = 0.3  # correlation of neighbouring samples, or with the rate of the reading, above which it is something else

# The path on which contact and sensor are replayed
CLEAN_PATH = 0.1  # derived: of the force noise, that a measured pose may bring: it adds half a percent to the noise
LEVER_ARM = 0.1  # [m] by which the noise of an attitude becomes one of the place of touch: what tips and rods measure
SHAKEN_PATHS = 4  # copies of a path from which the noise that it brings is read: a spread to a third, before it is smoothed over rows
SMOOTHING = 31  # rows of the Savitzky-Golay filter, order 3, where only a noisy pose is left to go by

# Copies of a path that differ by next to nothing, on which what slides or swings on a side of its own should do the same
BARELY = 2e-3  # chosen: of what a rate, or a slope of the pose, changes by in a tick: what copies differ by
APART = 0.3  # of the force's noise, by which copies part; derived: what is less adds 4 % to it
PARTED = 0.25  # [s] chosen: for which copies that parted are not believed
LEAST_COMPARED = 0.05  # chosen: of the rows in contact, that copies have to agree on

# Gain on left-out runs
RESAMPLES = 2000
WORTH = 0.02  # of the residual on left-out runs, geometric mean over them, by which a further cause has to lower it
FAR_OFF = 10.0  # times the limit of what passes for noise: nearer to it a further cause would explain the noise floor's error

# Parts of an explanation that hold
CARRIED = 0.3  # of the departure on left-out runs: of less no part is named
WORTH_IN_PART = 0.05  # of the residual on left-out runs, by which a cause has to lower it beside the others
INVARIANT = 0.15  # of its size, by which a cause may differ from run to run where something else is at work
MOST_RUNS = 0.8  # of the runs that have to agree
AS_GOOD = 0.1  # of what a cause takes off chi-square: another effect this near to it is a rival

# Two readings of one facility
ONE_OF_TWO = 2.0 * math.log(2.0)  # derived: of chi-square, the price of one of two equal readings
MOST_NOISE = 4.0  # standard deviations within which a difference is taken for noise

# Laws learned where no effect has a name for what departs
SMOOTH_KNOTS = 1e-4  # of the mean square of a knot's response: what a squared second difference costs, for knots without data
STRETCHES = 7  # of a slider, that are tried first: from a fiftieth of the travel to half of it
REFINEMENTS = 5  # steps by which the reach of a slider is refined
AS_AN_EQUATION = 0.05  # of a curve's rms, that an equation may leave
RESEMBLES = 0.9  # derived: cosine from which a named effect takes away four fifths of the square of what a law takes
