"""Before any test imports numpy: one BLAS thread, as in production (he3/__init__.py says why)."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
