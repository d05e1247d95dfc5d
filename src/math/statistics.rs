//! Means, variances, quantiles and tests.
