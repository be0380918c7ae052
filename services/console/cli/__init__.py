"""The operator's commands, one module each; slow imports are inside the command that needs them."""
