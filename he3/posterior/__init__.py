"""The posterior mean and variance on every cell of the site, exact and kept up to date one sample at a time.

Import `GridPosterior` from `he3.posterior.grid`. The other modules are its parts: how the rows of V = L^-1 K are
solved, stored, screened and cut into tiles. This package imports from `he3` only.
"""
