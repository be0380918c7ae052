"""The recorder: writes every message that reaches Earth into one MCAP file, and reads such files back.

`node` receives, `sink` and `files` write as long as there is room, `writer` is the format, `reader` and `recovery` read
files that may be damaged, `repair` completes them. The console replays recordings with `reader`. Imports
`services.runtime`, `services.mission` and `schemas`.
"""
