"""Starting a mission: its services as processes of their own, or all of its nodes in this process."""
