"""The science, pure: arrays in, arrays out. Only numpy and scipy, no I/O."""

import os

# One BLAS thread, unless the user asked for more. It counts only before numpy is first imported, so services and tests
# say the same. The belief's matrices are small: on cores that other processes use too, OpenBLAS's own threads wait for
# one another and take 50 times as long as one thread. Where a second thread pays, on the map, he3.posterior.grid shares
# out the cells itself. Results also stay the same bytes on machines with other numbers of cores.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
