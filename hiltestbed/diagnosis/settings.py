"""The tuning constants that several stages of the diagnosis share, each with its unit and where it
comes from; those of one module stand there.

A *derived* number follows from the equation that is named. A *calibrated* one was set on data sets
of the independent rig (``hiltestbed bench diagnosis``) and must be set again when the figure that
it is compared with changes. A *chosen* one is neither. Chi-square is in units of the noise.
"""

from __future__ import annotations

from scipy.stats import chi2, norm

MIN_POSE_NOISE = 1e-9  # chosen: [m, rad] floor of a pose without noise: round-off of the file
# chosen: rows of a computed channel that count as one sample, since its errors are smooth
CORRELATED_ROWS = 50
# derived: rows over all runs: with six channels a correlation is then known to 0.03
MIN_NOISE_ROWS = 150
# derived: standard deviations; one of 15,000 white records exceeds it by chance
SIGNIFICANCE_SIGMA = 4.0
# the same as a probability, for sums of a few squares
SIGNIFICANCE_LEVEL = float(norm.sf(SIGNIFICANCE_SIGMA))
# chi-square of one number that noise exceeds as rarely
SIGNIFICANT = float(chi2.isf(SIGNIFICANCE_LEVEL, 1))
# chosen: samples whose mean is tested as well: a smooth misfit far below the noise shows in it
BLOCK_ROWS = 8
# measured: share of the signal: another sub-stepping, another interpolation; a contact of a hundred
# steps is integrated to 0.1 to 0.24 %
MODEL_ERROR = 1e-3
# chosen: [m] converts attitude noise to noise of the contact point: size of tips and rods
LEVER_ARM = 0.1
# chosen: copies of a path for its noise: the spread to a third, before it is smoothed over rows
PERTURBED_COPIES = 4
# chosen: window of the Savitzky-Golay filter, order 3, where only a noisy pose is available
SMOOTHING_ROWS = 31
MIN_EXPLAINED = 0.3  # chosen: share of the departure on left-out runs, below which no part is named
MIN_RUN_SHARE = 0.8  # chosen: share of the runs that have to agree
UNKNOWN = 1e6  # chosen: times the noise: what is not known, or does not count
# chosen: [s] for which a contact, or a missing sample, shows in the output of a link
LINK_MEMORY = 0.05
# of the variance of the noise: mean square of a residual, from which a departure shows in it; that
# of 400 rows of noise exceeds 1.2 once in 500 runs
MIN_DEPARTURE = 1.5
