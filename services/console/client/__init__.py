"""The one operator client: `MissionClient`, the handle of a command, and how a running mission is found and joined."""
