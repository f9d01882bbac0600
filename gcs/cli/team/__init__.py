"""The verbs for a running team: they join its bus. The operator's page also shows recorded flights."""
