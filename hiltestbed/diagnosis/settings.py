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
# calibrated: selection threshold of a further cause where the causes so far already leave only
# noise
SELECTION = 100.0
# calibrated: the same where they leave more than noise; a factor of 150 in likelihood
SELECTION_INADEQUATE = 10.0
# derived: ambiguity threshold: a likelihood ratio of 1 : 400; within it hypotheses of as many
# parameters look the same
AMBIGUITY = 12.0
# derived: for each parameter, by the Bayesian information criterion for some thousand independent
# samples
PENALTY = math.log(1000.0)
MAX_CAUSES = 3  # chosen: on one link; a fourth was never right on a link of the benchmark
MAX_CAUSES_IN_PART = 5  # chosen: that are tried where those found leave more than noise
MAX_RIVALS = 2  # chosen: that are listed for a cause; a larger set identifies nothing

# Search
# derived: chi-square of one parameter at 99.5 %; a smaller reduction by linearisation is noise
MIN_LINEAR_GAIN = 8.0
BEAM_WIDTH = 5  # chosen: first causes for which a second one is sought
# chosen: pairs of causes for which a third one is sought, on a link whose replay is costly
COSTLY_BEAM_WIDTH = 2
MAX_PARTNERS = 6  # chosen: second causes that are fitted with each first one
MAX_FITS_PER_EFFECT = 3  # chosen: hypotheses of one effect (axes, variants) that are fitted
MAX_SINGLES = 40  # chosen: single causes that are fitted
# calibrated: most that a fit may gain over its linearised gain; 3.5 was the most of 553 fits on 18
# rig sets
LINEAR_GAIN_MARGIN = 10.0
# chosen: share of the best gain in chi-square; a variant of an effect that gains less rules out its
# other variants
MIN_VARIANT_GAIN = 0.3
# chosen: chi-square from the best, within which hypotheses are fitted to convergence; others while
# they may reach it
CLOSE_CHI2 = 60.0
# chosen: share of a parameter's range; a value closer to a bound is compared with the bound itself
NEAR_BOUND = 0.1
# calibrated: share of the reduction in chi-square that decimation may change; ten times the largest
# seen (1.2e-5)
DECIMATION_ERROR = 1e-4
MAX_RESIDUAL = 1e6  # chosen: [sigma] stands for a prediction that is not finite

# Noise
MIN_FREE_ROWS = 30  # chosen: rows away from contacts from which a noise floor is estimated
# chosen: noise of one axis of translation over another's; stick-slip motion looks like noise
MAX_AXIS_NOISE_RATIO = 3.0
MIN_POSE_NOISE = 1e-9  # chosen: [m, rad] floor of a pose without noise: round-off of the file
MIN_FORCE_NOISE = 1e-6  # chosen: share of the peak force: floor of a force without noise
# chosen: [m] uncertainty of the point of application; times the peak force it is the floor of a
# torque
FORCE_ARM_ERROR = 2e-6
# calibrated: [m, rad] difference between integrators of one step size, practice rig and this one
DYNAMICS_FLOOR = 2e-6
# derived: [m, rad] a h^2/8 of linear interpolation, at both ends; a = 8 m/s^2: 0.1 m/s, contacts of
# 40 ms
DYNAMICS_INTERPOLATION = 2e-6
# chosen: share of the force noise: difference between two implementations of one filter
COMPENSATION_FLOOR = 0.05
# chosen: rows of a computed channel that count as one sample, since its errors are smooth
CORRELATED_ROWS = 50
# chosen: [s] after the last contact that the search includes, where charge leakage and ringing show
TAIL_TIME = 0.15

# Noise of the force, from free flight
# derived: rows over all runs: with six channels a correlation is then known to 0.03
MIN_NOISE_ROWS = 150
# simulated: relative error of white noise estimated by third differences of n rows, times the root
# of n
WHITE_NOISE_ERROR = 1.5
# derived: standard deviations; one of 15,000 white records exceeds it by chance
SIGNIFICANCE_SIGMA = 4.0
SIGNIFICANCE_LEVEL = 3e-5  # derived: the same as a probability, for sums of a few squares
# chosen: samples beyond four standard deviations, in excess of those of normal noise
MIN_OUTLIERS = 3
# chosen: [sigma] beyond which a sample of noise with outliers counts by its logarithm
OUTLIER_KNEE = 3.0
# chosen: share of the noise variance that noise in proportion to the reading must add at the
# largest readings
MIN_SHARE_VARIANCE = 0.3

# Adequacy: goodness of fit
# chosen: samples whose mean is tested as well: a smooth misfit far below the noise shows in it
BLOCK_ROWS = 8
# derived: standard deviations allowed for a statistic; of some 30 statistics one exceeds it in 5000
# sets
ADEQUACY_SIGMA = 4.5
# derived: of a variance by the median of third differences of FLOOR_ROWS rows, 2.3 of which count
# as one
FLOOR_ERROR = 0.08
FLOOR_ROWS = 1500
# measured: share of the signal: another sub-stepping, another interpolation; a contact of a hundred
# steps is integrated to 0.1 to 0.24 %
MODEL_ERROR = 1e-3
# chosen: share of the departure of a computed channel that an explanation may leave
MAX_COMPUTED_RESIDUAL = 0.01
# chosen: times the propagated noise of the record, up to which a residual of the compensation may
# be that noise
MAX_PROPAGATED_NOISE = 1.7
# chosen: share of a stamp delay's chi-square in the compensation, which interpolation between rows
# may leave
MAX_SKEW_RESIDUAL = 0.2

# A delay that varies from sample to sample
MIN_JITTER_SPREAD = 1.2  # chosen: times the noise: spread from which the jitter of a sample shows
# chosen: with the next sample or the rate of the reading, above which it is not jitter
MAX_JITTER_CORRELATION = 0.3

# The path on which contact and sensor are replayed
# derived: share of the force noise that a measured path may add: half a percent of the noise
MAX_PATH_NOISE = 0.1
# chosen: [m] converts attitude noise to noise of the contact point: size of tips and rods
LEVER_ARM = 0.1
# chosen: copies of a path for its noise: the spread to a third, before it is smoothed over rows
PERTURBED_COPIES = 4
# chosen: window of the Savitzky-Golay filter, order 3, where only a noisy pose is available
SMOOTHING_ROWS = 31

# Perturbed copies of a path, on which sliding or swinging parts of a mechanism should move alike
# chosen: share of the change of a rate, or of a pose's slope, in a tick: perturbation of the copies
COPY_PERTURBATION = 2e-3
# derived: of the force noise, above which copies have diverged; less adds 4 % to the noise
DIVERGENCE_THRESHOLD = 0.3
DIVERGED_TIME = 0.25  # chosen: [s] for which copies are not used after they have diverged
MIN_COMPARED = 0.05  # chosen: share of the rows in contact on which the copies have to agree

# Gain on left-out runs
RESAMPLES = 2000  # chosen: draws of the bootstrap over runs
# chosen: share of the residual on left-out runs (geometric mean) by which a further cause has to
# lower it
MIN_HELDOUT_GAIN = 0.02
# chosen: times the limit of adequacy: below it a further cause would fit the error of the noise
# floor
MIN_EXCESS_TO_GROW = 10.0

# Parts of an explanation that hold
MIN_EXPLAINED = 0.3  # chosen: share of the departure on left-out runs, below which no part is named
# chosen: share of the residual on left-out runs by which each named cause has to lower it
MIN_HELDOUT_GAIN_IN_PART = 0.05
# chosen: share of a cause's size by which it may differ from run to run where something else acts
# as well
MAX_SIZE_SPREAD = 0.15
MIN_RUN_SHARE = 0.8  # chosen: share of the runs that have to agree
# chosen: share of a cause's gain in chi-square, within which another effect is a rival
RIVAL_MARGIN = 0.1

# Two interpretations of one facility
# derived: chi-square: choice between two equally likely interpretations
INTERPRETATION_PENALTY = 2.0 * math.log(2.0)
MAX_NOISE_SIGMA = 4.0  # chosen: standard deviations within which a difference is taken for noise

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
