"""The link to one vehicle: its connections, its frames, and what comes of their loss."""
