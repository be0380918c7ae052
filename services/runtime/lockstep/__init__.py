"""Virtual time across processes: a process acts when it is granted a step; the time manager grants it."""
