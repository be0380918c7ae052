"""Files that a process writes: for their owner alone, through no symbolic link, and locked against other processes.

`output` opens and replaces files; `lock` holds a lock beside one. Everything may import it; it imports the errors only.
"""
