"""Compare cordon's planner, LMPC and feedback linearisation, with nonlinear MPC: errors, settling and computing time.

Both fly the same shortened bundled missions and the same draws of the plant family (plant_draws.py), with the same
estimates and guard. Errors are those of the true paths; times are the processor time of a plan on the ring. Exit code 1
if cordon's planner leaves a plan unsolved or the NMPC more than a tenth of its plans, or if a vehicle leaves its ring;
2 without CasADi (pip install -e '.[rivals]').
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
    reader.add_argument("--only", action="append", choices=scenes, help="fly only this scene; may be repeated")
    reader.add_argument("--plot", type=Path, metavar="FOLDER", help="draw the figures into this folder")
    given = reader.parse_args()
    sys.exit(main(given.count, given.first, given.only or scenes, given.plot))
