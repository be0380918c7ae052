"""The science, pure: arrays in, arrays out. Only numpy and scipy, no I/O.

Importing it changes nothing. A program that uses other cores too should set OPENBLAS_NUM_THREADS=1 before it imports
numpy, as our own processes do: `services.runtime.entry` says why.
"""
