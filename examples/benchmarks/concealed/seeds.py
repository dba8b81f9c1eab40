"""Which seeds a set of cases has: calibration sets thresholds, each score is read once and then used up."""

SEEDS = {"calibration": 0, "score": 10000, "score2": 20000, "score3": 30000, "score4": 40000,
         "score5": 50000, "score6": 60000, "score7": 70000, "score8": 80000, "calibration2": 90000,
         "calibration4": 120000, "calibration5": 130000, "calibration6": 140000, "score9": 150000,
         "calibration7": 160000, "score10": 170000, "score11": 180000, "calibration8": 190000,
         "score12": 200000, "calibration9": 210000}
TURNED = 150000  # from this seed on every set begins its lists of effects and conditions elsewhere
SLOT = 380  # seeds per class and cell; 26 slots stay below the ten thousand of a set


def turn_of(seed):
    """Where the lists of a set begin, 0 for the sets that were made before lists were turned."""
    return 1 + (seed - TURNED) // 10000 if seed >= TURNED else 0
