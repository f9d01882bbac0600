"""Measure the auction of places on rings on random teams: how soon it agrees, how good its choice is, whether it stays.

Teams of 2 to 32 vehicles, 1 to 6 rings of 1 to 8 places and a connected radio graph are drawn from a seed. A share of
the messages is lost, and scores carry noise. After the first agreement one thing happens to each team: a target loses
its importance, a vehicle joins or falls silent, or two parts of the team come into range of each other.

Messages are counted from the change on, and for a silent vehicle from the end of its bids: in rounds in which each
vehicle publishes once (sent), and in rounds in which each has received a message from each neighbour (received), which
loss makes longer. The cost of the first agreement is compared with the central optimum of the scores without noise,
where all targets have the same value in total time to get there. Changes are those after all bids are known to all.
Exit code 1 if a team needs more than two diameters of received messages or has a conflict later, if a choice changes
after agreement, or if the median cost is more than 5 % above the optimum.
"""

import sys
from collections import Counter
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import pairwise
from math import ceil, inf
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from agents.ring.auction import RELEASE_S, Auction, ring_score
from estimation.state import Vector
from tests.experiments.arguments import seeded_parser

PERIOD_S = 0.2
NOISE = 0.05
SPEED_M_S, SIZE_M = 3.0, 80.0
COST_ABOVE_MAX = 0.05
EVENTS = ("importance falls", "joins", "silent", "parts heal")
DIAMETERS = ((1, 1), (2, 3), (4, 7), (8, 31))
"""The rows of the table."""

Links = frozenset[tuple[int, int]]


class Team(NamedTuple):
    """A team: times (n, m) to get to the rings and scores (n, m), 0 for rings that are not eligible, and its places."""

    times_s: Vector
    scores: Vector
    has_one_value: bool
    places: tuple[int, ...]


class Phase(NamedTuple):
    """What holds from a change on: the vehicles present, their links and the rings with importance."""

    present: frozenset[int]
    links: Links
    rings: frozenset[int]


class Measured(NamedTuple):
    """What a team did after a change: the diameter, messages until agreement and conflicts ended, and later changes."""

    event: str
    diameter: int
    sent: int
    received: int
    conflict: int
    changes: int
    above: float
    has_one_value: bool
    payload_bytes: int


def drawn_links(count: int, draw: np.random.Generator) -> Links:
    """Return a connected graph of random kind: path, ring, star, complete, tree with chords, or radio range."""
    kind, order = draw.integers(6), draw.permutation(count).tolist()
    pairs = [(a, b) for a in range(count) for b in range(a)]
    if kind == 0:
        chosen = list(pairwise(order))
    elif kind == 1:
        chosen = list(zip(order, [*order[1:], order[0]], strict=True))
    elif kind == 2:
        chosen = [(order[0], other) for other in order[1:]]
    elif kind == 3:
        chosen = pairs
    elif kind == 4:
        chosen = [(order[i], order[int(draw.integers(i))]) for i in range(1, count)]
        chosen += [pair for pair in pairs if draw.random() < 1.0 / count]
    else:
        at = draw.uniform(size=(count, 2))
        by_length = sorted(pairs, key=lambda pair: float(np.hypot(*(at[pair[0]] - at[pair[1]]))))
        size = next(size for size in range(len(pairs) + 1) if is_connected(range(count), both_ways(by_length[:size])))
        chosen = by_length[:size]
    return both_ways(chosen)


def both_ways(pairs: Iterable[tuple[int, int]]) -> Links:
    return frozenset(way for a, b in pairs if a != b for way in ((a, b), (b, a)))


def hops(start: int, links: Links) -> dict[int, int]:
    """Return the number of hops from a vehicle to each that it reaches."""
    found, edge = {start: 0}, [start]
    while edge:
        edge = sorted({b for a, b in links if a in edge} - set(found))
        found |= dict.fromkeys(edge, max(found.values()) + 1)
    return found


def is_connected(vehicles: Iterable[int], links: Links) -> bool:
    all_of_them = set(vehicles)
    return all_of_them <= set(hops(min(all_of_them), links))


def diameter(phase: Phase) -> int:
    return max(max(hops(start, phase.links).values()) for start in phase.present)


def without(vehicle: int, phase: Phase) -> Phase:
    return Phase(phase.present - {vehicle}, frozenset(link for link in phase.links if vehicle not in link), phase.rings)


def drawn_team(draw: np.random.Generator) -> Team:
    count, rings = int(draw.integers(2, 33)), int(draw.integers(1, 7))
    starts_m, centres_m = draw.uniform(0.0, SIZE_M, (count, 1, 2)), draw.uniform(0.0, SIZE_M, (rings, 2))
    times_s = np.hypot(*np.moveaxis(starts_m - centres_m, 2, 0)) / SPEED_M_S
    has_one_value = bool(draw.random() < 0.5)
    values = [(0.8, 0.2) if has_one_value else (draw.uniform(0.6, 1.0), draw.uniform(0.0, 0.5)) for _ in range(rings)]
    scores = np.array([[ring_score(*value, t) for value, t in zip(values, row, strict=True)] for row in times_s])
    scores[draw.random(scores.shape) < 0.2] = 0.0
    return Team(times_s, scores, has_one_value, tuple(draw.integers(1, 9, rings).tolist()))


def drawn_event(team: Team, draw: np.random.Generator) -> tuple[str, Phase, Phase]:
    """Return what happens to a team, and what holds before and after it."""
    count, rings = team.scores.shape
    whole = Phase(frozenset(range(count)), drawn_links(count, draw), frozenset(range(rings)))
    event = EVENTS[int(draw.integers(len(EVENTS)))]
    if event == "importance falls":
        return event, whole, whole._replace(rings=whole.rings - {int(draw.integers(rings))})
    if event == "parts heal":
        half = set(draw.permutation(count)[: count // 2].tolist())
        return event, whole._replace(links=frozenset(each for each in whole.links if len(half & {*each}) != 1)), whole
    spare = [each for each in range(count) if is_connected(*without(each, whole)[:2])]
    part = without(spare[int(draw.integers(len(spare)))], whole)
    return (event, part, whole) if event == "joins" else (event, whole, part)


def total(team: Team, choices: Sequence[int | None]) -> float:
    """Return what is compared of choices: the total time of vehicles with a place, or weighted with the values."""
    placed = [(vehicle, ring) for vehicle, ring in enumerate(choices) if ring is not None]
    return float(sum(team.times_s[each] if team.has_one_value else 1.0 / team.scores[each] for each in placed))


def optimum(team: Team, phase: Phase) -> list[int | None]:
    """Return the choices with the most vehicles placed, and of these the least sum of the scores' reciprocals."""
    columns = [ring for ring, places in enumerate(team.places) if ring in phase.rings for _ in range(places)]
    cost = np.full((len(team.scores), len(columns) + len(team.scores)), 1e6)
    for vehicle in phase.present:
        for column, ring in enumerate(columns):
            cost[vehicle, column] = 1.0 / team.scores[vehicle, ring] if team.scores[vehicle, ring] else 1e9
    choices: list[int | None] = [None] * len(team.scores)
    for vehicle, column in zip(*linear_sum_assignment(cost), strict=True):
        if column < len(columns) and vehicle in phase.present:
            choices[vehicle] = columns[column]
    return choices


class Flight:
    """A team that publishes in rounds, over a bus that loses messages."""

    def __init__(self, team: Team, loss: float, draw: np.random.Generator) -> None:
        self.team, self._loss, self._draw = team, loss, draw
        ids = list(range(1, len(team.scores) + 1))
        self.auctions = [Auction(each, ids, team.places) for each in ids]
        self.time_s, self.payload_bytes = float(draw.uniform(0.0, 1e4)), 0
        self._choices: list[int | None] = [None] * len(ids)
        self._sent: list[tuple[int, int, bytes]] = []

    def round(self, phase: Phase) -> tuple[list[int | None], Links]:
        """Receive what was sent, choose and publish; return the choices, and the links that will have delivered."""
        for sender, receiver, payload in self._sent:
            self.auctions[receiver].receive(sender + 1, payload, self.time_s)
        self.time_s += PERIOD_S
        payloads = {}
        for vehicle in phase.present:
            noisy = self.team.scores[vehicle] * (1.0 + NOISE * self._draw.normal(size=len(self.team.places)))
            scores = {ring: min(1.0, max(1e-6, float(noisy[ring]))) for ring in phase.rings}
            eligible = {ring: score for ring, score in scores.items() if self.team.scores[vehicle, ring] > 0.0}
            self._choices[vehicle] = self.auctions[vehicle].step(eligible, self.time_s)
            payloads[vehicle] = self.auctions[vehicle].payload(self.time_s)
            self.payload_bytes = max(self.payload_bytes, len(payloads[vehicle]))
        for vehicle in set(range(len(self._choices))) - phase.present:
            self._choices[vehicle] = None
        links = sorted(phase.links)
        delivered = [
            link for link, draw in zip(links, self._draw.random(len(links)), strict=True) if draw >= self._loss
        ]
        self._sent = [(sender, receiver, payloads[sender]) for sender, receiver in delivered]
        return list(self._choices), frozenset(delivered)

    def is_known_to_all(self, phase: Phase) -> bool:
        """Return whether all vehicles choose from the same bids, those of all present."""
        bids = [self.auctions[vehicle].bids for vehicle in phase.present]
        return all(each == bids[0] for each in bids) and set(bids[0]) == {vehicle + 1 for vehicle in phase.present}


def has_conflict(choices: Sequence[int | None], places: Sequence[int]) -> bool:
    """Return whether more vehicles have chosen a ring than it has places."""
    counts = Counter(choices)
    return any(counts[ring] > count for ring, count in enumerate(places))


def measured(flight: Flight, phase: Phase, event: str, delay_s: float) -> Measured:
    """Fly a phase; a change has effect after a delay."""
    count, delay, across = len(phase.present), ceil(delay_s / PERIOD_S), diameter(phase)
    rounds = delay + 4 * across + 10 + ceil(flight.auctions[0].settling_s / PERIOD_S)
    history, known, complete = list[list[int | None]](), list[bool](), [0]
    waiting = set(phase.links)
    for at in range(rounds):
        choices, delivered = flight.round(phase)
        history.append(choices)
        known.append(flight.is_known_to_all(phase))
        if at >= delay:
            waiting -= delivered
            complete.append(complete[-1] + (not waiting))
            waiting = waiting or set(phase.links)
    history, known = history[delay:], known[delay:]
    agreed = known.index(True) if True in known else rounds
    steps = pairwise(history[agreed:])
    changes = sum(a != b for one, other in steps for a, b in zip(one, other, strict=True))
    differs = [at + 1 for at, choices in enumerate(history) if choices != history[-1]]
    conflicts = [at + 1 for at, choices in enumerate(history) if has_conflict(choices, flight.team.places)]
    best, last = optimum(flight.team, phase), history[-1]
    is_full = count - last.count(None) == count - best.count(None)
    above = total(flight.team, last) / max(total(flight.team, best), 1e-9) - 1.0 if is_full else inf
    sent = max([0, *differs, *conflicts])
    received = 0 if sent == 0 else complete[min(sent, len(complete) - 1) - 1] + 1
    conflict = 0 if not conflicts else complete[conflicts[-1] - 1] + 1
    return Measured(
        event, across, sent, received, conflict, changes, above, flight.team.has_one_value, flight.payload_bytes
    )


def flown(loss: float, seed: int) -> list[Measured]:
    """Fly a team: its start, and what happens to it."""
    draw = np.random.default_rng([seed, 64])
    team = drawn_team(draw)
    event, before, after = drawn_event(team, draw)
    flight = Flight(team, loss, draw)
    start = measured(flight, before, "start", 0.0)
    delay_s = {"importance falls": RELEASE_S, "silent": flight.auctions[0].settling_s}.get(event, 0.0)
    is_whole = is_connected(before.present, before.links)
    return [start] * is_whole + [measured(flight, after, event, delay_s + PERIOD_S * (delay_s > 0.0))]


def shown(rows: list[Measured]) -> str:
    """Return the columns of a table for teams."""
    share = max(each.received / max(each.diameter, 1) for each in rows)
    return (
        f"{len(rows)} | {max(each.diameter for each in rows)} | {max(each.conflict for each in rows)} "
        f"| {max(each.received for each in rows)} | {share:.2f} | {max(each.sent for each in rows)} "
        f"| {np.mean([each.sent > 2 * each.diameter for each in rows]):.1%} | {sum(each.changes for each in rows)}"
    )


def is_late(each: Measured) -> bool:
    return max(each.received, each.conflict) > 2 * each.diameter


def main(count: int, first: int, loss: float) -> int:
    """Fly the teams and print the tables."""
    with ProcessPoolExecutor() as pool:
        found = [
            each for team in pool.map(partial(flown, loss), range(first, first + count), chunksize=4) for each in team
        ]
    print(
        "| after | diameter | teams | largest diameter | conflict, received | until agreement, received | in diameters "
        f"| sent | more than two diameters sent | changes |\n{'|---' * 10}|"
    )
    for event in ("start", *EVENTS):
        for low, high in DIAMETERS:
            rows = [each for each in found if each.event == event and low <= each.diameter <= high]
            if rows:
                print(f"| {event} | {low} to {high} | {shown(rows)} |")
    missed = any(is_late(each) or each.changes for each in found)
    print(f"\n| after | compared | median above the optimum | 95 % | largest |\n{'|---' * 5}|")
    for event in ("start", *EVENTS):
        for has_one_value, name in ((True, "total time"), (False, "time weighted with values")):
            above = [each.above for each in found if each.event == event and each.has_one_value == has_one_value]
            if above:
                median, high, most = np.quantile(above, (0.5, 0.95, 1.0))
                print(f"| {event} | {name} | {median:.2%} | {high:.2%} | {most:.2%} |")
                missed = missed or (event == "start" and median > COST_ABOVE_MAX)
    print(f"\nlargest payload: {max(each.payload_bytes for each in found)} bytes")
    return 1 if missed else 0


if __name__ == "__main__":
    reader = seeded_parser("auction", __doc__, 500)
    reader.add_argument("--loss", type=float, default=0.2, help="share of lost messages (default: %(default)s)")
    given = reader.parse_args()
    sys.exit(main(given.count, given.first, given.loss))
