"""The operator's commands, one module each; what is heavy is imported inside the command that needs it."""
