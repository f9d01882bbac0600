"""ROS 2: flight logs as bags, and a bridge between a team's bus and the nodes of ROS 2, without an installation of it.

Positions are in one frame of REP 103 and REP 105: metres about the mission's origin, x east, y north, z up.
"""
