"""The members beside a vehicle: those that may be next to it until it looks at all again."""

from math import remainder, tau

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st

from agents.ring.place import neighbours, ring_place
from agents.team.messages import NeighbourAngle
from agents.team.ring_members import BESIDE_FOR_S, RingMembers

WITHIN_M, RELATIVE_M_S = 3.0, 7.0


@given(st.integers(2, 64), st.integers(0, 10_000), st.floats(0.0, 2.0))
def test_the_next_on_either_side_is_beside_until_the_next_look(count: int, seed: int, apart_m: float) -> None:
    """Compared with all, of vehicles on a ring and around it that may pass each other at 7 m/s in the meantime.

    None passes the vehicle itself at its radius, nor is one where it could.
    """
    random = np.random.default_rng(seed)
    radius_m = float(random.uniform(8.0, 60.0))
    own_rad, own_rad_s = (
        float(random.uniform(0.0, tau)),
        0.5 * RELATIVE_M_S * float(random.uniform(-1.0, 1.0)) / radius_m,
    )
    members = RingMembers(lambda _: True)
    for sender in range(1, count + 1):
        rate_rad_s = 0.5 * RELATIVE_M_S * float(random.uniform(-1.0, 1.0)) / radius_m
        place_m, bearing_rad = radius_m + float(random.normal(0.0, apart_m)), float(random.uniform(0.0, tau))
        along_m = abs(remainder(bearing_rad - own_rad, tau)) * radius_m
        if abs(place_m - radius_m) > WITHIN_M or along_m > RELATIVE_M_S * BESIDE_FOR_S:
            members.receive(NeighbourAngle(sender, 10.0, bearing_rad, rate_rad_s, place_m).numbers)
    assume(members.ids)
    beside = members.beside(own_rad, radius_m, 10.0, WITHIN_M)
    for after_s in (0.0, 0.5 * BESIDE_FOR_S, BESIDE_FOR_S):
        at_s, bearing_rad = 10.0 + after_s, own_rad + own_rad_s * after_s
        near, whole = (ring_place(bearing_rad, members.bearings_rad(at_s, of)) for of in (beside, members.ids))
        assert (near.lead_rad, near.lag_rad) == (whole.lead_rad, whole.lag_rad)
        those, of_all = (members.abreast(at_s, radius_m, WITHIN_M, of) for of in (beside, members.ids))
        assert neighbours(bearing_rad, those) == neighbours(bearing_rad, of_all)


def test_in_a_large_team_few_are_beside() -> None:
    members = RingMembers(lambda _: True)
    for sender in range(1, 64):
        members.receive(NeighbourAngle(sender, 10.0, sender * tau / 64.0, 0.02, 61.0).numbers)
    assert members.beside(0.0, 61.0, 10.0, WITHIN_M) == (1, 63)
