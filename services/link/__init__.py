"""The only path between Moon and Earth: light time, data rate, loss, contact windows."""
