"""The messages on the wire, their codec and the table of topics; no other code."""
