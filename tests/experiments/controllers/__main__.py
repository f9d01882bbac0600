"""Compare cordon's planner, LMPC and feedback linearisation, with nonlinear MPC: errors, settling and computing time.

Both fly the same bundled missions, shortened, and the same draws of the plant family (plant_draws.py), from the same
estimates and behind the same guard. Errors are those of the true paths; times are those of the processor for a plan on
the ring. Exit code 1 when cordon's planner leaves a plan unsolved or the NMPC more than a tenth of its own, or when a
vehicle leaves its ring; 2 without CasADi (pip install -e '.[rivals]').
"""

import sys
from pathlib import Path

from tests.experiments.arguments import seeded_parser
from tests.experiments.controllers.comparison import main
from tests.experiments.controllers.flights import COURSES, FAMILY

DRAWS = 100

if __name__ == "__main__":
    reader = seeded_parser("controllers", __doc__, DRAWS)
    scenes = [*COURSES, FAMILY]
    reader.add_argument("--only", action="append", choices=scenes, help="fly this alone; may be given several times")
    reader.add_argument("--plot", type=Path, metavar="FOLDER", help="draw the figures into this folder")
    given = reader.parse_args()
    sys.exit(main(given.count, given.first, given.only or scenes, given.plot))
