"""The per-vehicle agent: a pure core that decides and plans, and the asynchronous shell around it."""
