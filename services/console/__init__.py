"""The operator: command line, pictures and web page."""
