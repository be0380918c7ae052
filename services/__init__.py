"""The services: separate processes that talk over Eclipse Zenoh, built as cores without I/O inside thin shells."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy reads it; why is said in he3/__init__.py
