"""What to record next."""

from __future__ import annotations

from pwaid.mismatch.effects.registry import CATALOGUE

__all__ = ["next_experiment"]


def next_experiment(problem, decision, singles) -> str:
    """The cheapest experiment that would settle what these recordings leave open."""
    repeat = "" if problem.floor.trusted else " Record one input twice: repeats fix the noise floor."
    by_id = {e.id: e for e in CATALOGUE}
    if decision.verdict == "one_of":
        a, b = decision.members[0].located[0].effect, decision.members[1].located[0].effect
        text = a.separated_by if b.id in a.confused_with or not b.separated_by else b.separated_by
        return f"To separate {a.id} from {b.id}: {text}.{repeat}"
    if decision.verdict == "named":
        effect = decision.chosen.located[0].effect
        rivals = [by_id[r].id for r in effect.confused_with if r in by_id]
        rival = f" (excludes {', '.join(rivals[:2])})" if rivals else ""
        return f"To be surer of {effect.id}{rival}: {effect.separated_by}.{repeat}"
    if decision.verdict == "unexplained":
        return ("Repeat one recording unchanged: a mismatch that does not repeat is a disturbance, one that does is "
                "physics outside the catalogue. Then the same input at half and at double amplitude.")
    return ("Record at other amplitudes and speeds than these: an effect never excited cannot be seen." + repeat)
