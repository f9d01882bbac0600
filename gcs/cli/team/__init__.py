"""The verbs for a team that flies already: they join its bus. A recorded flight is shown as one that flies."""
