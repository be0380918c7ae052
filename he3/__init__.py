"""The science, pure: arrays in, arrays out. Only numpy and scipy, no I/O."""

import os

# One BLAS thread, unless the user asked for more, and before numpy reads it. The belief's matrices are small: on cores
# that other processes use too, OpenBLAS's own threads wait for one another and take 50 times as long as one thread.
# Where a second thread pays, on the map, he3.gridposterior splits the cells itself. Results also stay the same bytes.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
