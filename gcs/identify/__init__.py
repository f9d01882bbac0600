"""The user's side of identification: the excerpts of logs that a plant is fitted to, and the page that shows the fit.

It may import report, the readers of logs and estimation's identification.
"""
