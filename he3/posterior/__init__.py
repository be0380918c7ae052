"""The posterior mean and variance on every cell of the site, exact and updated one sample at a time.

Import `GridPosterior` and `PosteriorMap` from `he3.posterior.grid`. The other modules are its parts: how the rows of
V = L^-1 K are solved (`row_solving`), provided (`rows`: `stored_rows`, `separable_rows`, `split_rows`), screened
(`screening`), cut into tiles (`tiles`), summed over cells (`sums`) and verified (`probes`). This package imports from
`he3` only.
"""
