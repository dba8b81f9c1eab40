"""The scorer of the sealed cases: Wilson intervals, the seal, judgement of right and wrong reports, the
driver."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "examples" / "benchmarks"))

from concealed import report_page, run, run_all, score, seal
from concealed.baselines import bic
from concealed.catalogue import FAMILY
from concealed.judge import judge
from concealed.wilson import wilson


def entry(name="single", *effects, cell="rich"):
    return {"class": name, "cell": cell, "condition": "multisine", "plant": "rotary_drive", "stranger": "",
            "measured": ["omega_m"], "noise": 0.02, "detectability": {}, "sigma": {"omega_m": 0.1},
            "clutter": {"drag": 0.01},
            "floor_rmse": {"test_2.csv": {"omega_m": 0.1}},
            "effects": [{"id": i, "equivalents": [], "parameters": {"level": {"value": 2.0, "unit": "N m"}}}
                        for i in effects]}


def report(verdict, *ids, value=2.0, repaired=0.1):
    rows = {"refitted": {"rmse": 0.5}, "repaired": {"rmse": repaired}}
    effects = [{"id": i, "parameters": {"level": {"value": value, "low": 1.9, "high": 2.1, "unit": "N m"}}}
               for i in ids]
    return {"verdict": verdict, "effects": effects, "fit": {"test_2.csv": {"omega_m": rows}}, "seconds": 1.0}


def test_wilson_solves_its_own_quadratic():
    for hits, n in ((0, 20), (3, 20), (19, 20), (20, 20)):
        for bound in wilson(hits, n):
            if 0.0 < bound < 1.0:
                assert abs(hits / n - bound) == pytest.approx(1.959963985 * np.sqrt(bound * (1 - bound) / n))
    with pytest.raises(ValueError, match="0 ≤ hits ≤ n"):
        wilson(3, 2)


def test_a_right_name_with_right_numbers():
    v = judge("c", entry("single", "coulomb_friction"), report("named", "coulomb_friction", value=2.06),
              FAMILY)
    assert v.facts["exact_first"] and v.facts["in_set"] and v.facts["family"] and not v.facts["wrong_name"]
    assert v.removed == pytest.approx(1.0)
    assert v.errors == {"coulomb_friction.level": pytest.approx(0.03)}
    assert v.covered == {"coulomb_friction.level": True}


def test_half_of_the_explainable_error_removed():
    half = np.sqrt(0.5 * (0.5**2 + 0.1**2))
    v = judge("c", entry("single", "coulomb_friction"), report("named", "coulomb_friction", repaired=half),
              FAMILY)
    assert v.removed == pytest.approx(0.5)


def test_a_sibling_gets_the_family_only():
    v = judge("c", entry("single", "coulomb_friction"), report("named", "stribeck_friction"), FAMILY)
    assert v.facts["family"] and v.facts["wrong_name"]
    assert not v.facts["exact_first"]
    assert v.removed is None


def test_sets_larger_than_three_do_not_count_and_pairs_need_both():
    ids = ("coulomb_friction", "quadratic_drag", "end_stop", "input_delay")
    assert not judge("c", entry("single", "end_stop"), report("one_of", *ids), FAMILY).facts["in_set"]
    assert judge("c", entry("single", "end_stop"), report("one_of", *ids[:3]), FAMILY).facts["in_set"]
    two = entry("pair", "coulomb_friction", "end_stop")
    assert judge("c", two, report("named", "end_stop", "coulomb_friction"), FAMILY).facts["both"]
    assert not judge("c", two, report("named", "end_stop"), FAMILY).facts["both"]


def test_a_missing_report_is_a_failure_never_a_refusal(tmp_path):
    key_folder, results, sealed = written(tmp_path, {"c1": entry("clean"), "c2": entry("out_of_catalogue")})
    verdicts = score.load(key_folder, sealed, results)
    assert all(v.facts["failed"] and not v.facts["refused"] and v.facts["false_name"] for v in verdicts)


def test_a_name_from_the_clutter_is_false_but_not_absent(tmp_path):
    answers = {"c1": report("named", "quadratic_drag"), "c2": report("named", "end_stop"), "c3": report("agreement")}
    key_folder, results, sealed = written(tmp_path, {c: entry("parameters") for c in answers})
    answered(results, answers)
    verdicts = score.load(key_folder, sealed, results)
    assert [v.facts["false_name"] for v in verdicts] == [True, True, False]
    assert [v.facts["absent_name"] for v in verdicts] == [False, True, False]


def written(tmp_path, cases):
    key_folder, results = tmp_path / "key", tmp_path / "results"
    (key_folder / "truth").mkdir(parents=True)
    results.mkdir()
    for name, one in cases.items():
        (key_folder / "truth" / f"{name}.npz").write_bytes(b"truth")
        one["truth_sha256"] = seal.sha256(key_folder / "truth" / f"{name}.npz")
    (key_folder / "key.json").write_text(json.dumps({"cases": cases}), encoding="utf-8")
    seal.seal(key_folder / "key.json", tmp_path / "key.sha256")
    return key_folder, results, tmp_path / "key.sha256"


def answered(results, answers):
    for case, answer in answers.items():
        (results / case).mkdir()
        (results / case / "report.json").write_text(json.dumps(answer), encoding="utf-8")


def test_a_changed_key_is_refused(tmp_path, capsys):
    key_folder, results, sealed = written(tmp_path, {"c1": entry("clean")})
    assert seal.main([str(key_folder / "key.json"), str(sealed), "--check"]) == 0
    with (key_folder / "key.json").open("a", encoding="utf-8") as f:
        f.write(" ")
    code = score.main(["--key", str(key_folder), "--seal", str(sealed), "--results", str(results)])
    assert code == 2
    assert "score the key that was sealed" in capsys.readouterr().err


def test_the_scorer_writes_tables_and_a_picture(tmp_path, capsys):
    cases = {"c1": entry("single", "coulomb_friction"), "c2": entry("clean"), "c3": entry("single",
                                                                                          "end_stop")}
    key_folder, results, sealed = written(tmp_path, cases)
    answers = {"c1": report("named", "coulomb_friction"), "c2": report("agreement"),
               "c3": report("unexplained")}
    answered(results, answers)
    call = ["--key", str(key_folder), "--seal", str(sealed), "--results", str(results), "--save",
            str(tmp_path / "s")]
    assert score.main(call) == 0
    last = capsys.readouterr().out.strip().splitlines()[-1]
    result = json.loads(last.removeprefix("RESULT "))
    assert result["rich/single"]["exact_first"]["rate"] == 0.5
    assert result["rich/single"]["refused"]["hits"] == 1
    assert result["rich/clean"]["false_name"]["rate"] == 0.0
    text = (tmp_path / "s" / "tables.md").read_text(encoding="utf-8")
    assert "| `c3` | rich, single |" in text
    assert "| exact name first | ≥ 92% | 50% (1/2; 9%–91%) | **missed** (n < 20) |" in text
    assert "| false name on clean data | ≤ 2% | 0% (0/1; 0%–79%) | met (n < 20) |" in text
    assert (tmp_path / "s" / "confusion_rich.png").stat().st_size > 1000


def test_the_driver_resumes_and_passes_what_is_left_out(tmp_path, capsys):
    cases, results = tmp_path / "cases", tmp_path / "results"
    for name in ("a", "b"):
        (cases / name).mkdir(parents=True)
        (cases / name / "case.toml").write_text("", encoding="utf-8")
    (cases / "runs.json").write_text(json.dumps({"a": [], "b": ["end_stop"]}), encoding="utf-8")
    tool = tmp_path / "tool.py"
    tool.write_text("import json, sys, pathlib\n"
                    "out = pathlib.Path(sys.argv[sys.argv.index('-o') + 1])\n"
                    "(out / 'report.json').write_text(json.dumps(sys.argv))\n", encoding="utf-8")
    call = [str(cases), "-o", str(results), "--command", f"{sys.executable} {tool}"]
    run.main(call)
    assert "end_stop" in (results / "b" / "report.json").read_text(encoding="utf-8")
    run.main(call)
    assert '"ran": 0' in capsys.readouterr().out.strip().splitlines()[-1]


def candidates(*rows):
    return {"candidates": [{"id": i, "bic": b, "values": v} for i, b, v in rows], "bic_null": 100.0, "effects": [],
            "hypotheses_tried": 3, "seconds": 2.0}


def test_bic_alone_names_the_lowest_whatever_it_is_unless_the_null_is_lower(tmp_path, capsys):
    found = bic.diagnose(candidates(("end_stop", 90.0, {"position": 1.0}), ("quadratic_drag", 95.0, {})))
    assert found["verdict"] == "named"
    assert found["effects"] == [{"id": "end_stop", "parameters": {"position": {"value": 1.0}}}]
    pair = ("coulomb_friction + end_stop", 80.0, {"coulomb_friction.level": 2.0, "end_stop.position": 1.0})
    found = bic.diagnose(candidates(pair))
    assert [e["id"] for e in found["effects"]] == ["coulomb_friction", "end_stop"]
    assert found["effects"][0]["parameters"] == {"level": {"value": 2.0}}
    assert bic.diagnose(candidates(("end_stop", 101.0, {})))["verdict"] == "parameters_only"
    assert bic.diagnose(candidates(("end_stop", None, {})))["verdict"] == "parameters_only"
    old = {"candidates": [{"id": "end_stop"}], "hypotheses_tried": 1, "seconds": 1.0}
    (tmp_path / "results" / "c1").mkdir(parents=True)
    (tmp_path / "results" / "c1" / "report.json").write_text(json.dumps(old), encoding="utf-8")
    assert bic.main([str(tmp_path / "results"), "-o", str(tmp_path / "out")]) == 2
    assert "run the diagnosis again" in capsys.readouterr().err


def scored(tmp_path, answers, cases, name="pwaid"):
    key_folder, results, sealed = written(tmp_path, cases)
    answered(results, answers)
    reasons = tmp_path / "reasons.json"
    reasons.write_text(json.dumps({"c2": "the stop was never pressed hard"}), encoding="utf-8")
    assert score.main(["--key", str(key_folder), "--seal", str(sealed), "--results", str(results), "--reasons",
                       str(reasons), "--save", str(tmp_path / "scores" / name)]) == 0


def test_the_page_is_remade_between_its_markers_and_keeps_the_rest(tmp_path):
    hidden = entry("concealed_noise", "quadratic_drag")
    cases = {"c1": entry("single", "coulomb_friction"), "c2": entry("single", "end_stop", cell="hard"), "c3": hidden}
    scored(tmp_path, {"c1": report("named", "coulomb_friction"), "c2": report("unexplained"),
                      "c3": report("agreement")}, cases)
    page = tmp_path / "proof.md"
    page.write_text(f"before\n{report_page.BEGIN}\nold\n{report_page.END}\nafter\n", encoding="utf-8")
    call = [str(tmp_path / "scores"), "--page", str(page)]
    assert report_page.main(call) == 0
    text = page.read_text(encoding="utf-8")
    assert report_page.main(call) == 0
    assert page.read_text(encoding="utf-8") == text
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert "old" not in text.split(report_page.END)[0].split(report_page.BEGIN)[1].splitlines()
    assert "the stop was never pressed hard" in text
    assert "| noise | 1 | 0% (0/1; 0%–79%) | 0% (0/1; 0%–79%) | 100% (1/1; 21%–100%) |" in text
    assert "](img/proof_confusion_hard.png)" in text
    assert (tmp_path / "img" / "proof_confusion_rich.png").exists()
    page.write_text("no markers", encoding="utf-8")
    assert report_page.main(call) == 2


def test_one_command_stops_before_a_score_set_is_sealed_and_refuses_another_composition(tmp_path, monkeypatch, capsys):
    calls = []
    monkeypatch.setattr(run_all, "call", lambda script, *words: calls.append(script))
    assert run_all.main([str(tmp_path), "--set", "score", "--n", "1"]) == 0
    assert calls == ["generate.py"]
    assert "--seal" in capsys.readouterr().out
    with pytest.raises(SystemExit, match="choose another folder"):
        run_all.main([str(tmp_path), "--set", "score", "--n", "2"])
    (tmp_path / "scores" / "pwaid").mkdir(parents=True)
    (tmp_path / "scores" / "pwaid" / "score.json").write_text("{}", encoding="utf-8")
    run_all.main([str(tmp_path), "--set", "score", "--n", "1", "--seal", "x", "--baselines", "bic", "majority"])
    assert calls[1:] == ["run.py", "baselines/bic.py", "run.py", "score.py", "score.py", "score.py"]


def test_a_wrong_name_beside_the_right_one_is_a_wrong_name():
    v = judge("c", entry("concealed_mask", "coulomb_friction", "input_delay"),
              report("named", "coulomb_friction", "cubic_stiffness"), FAMILY)
    assert v.facts["wrong_name"] and not v.facts["both"]
    either = judge("c", entry("single", "coulomb_friction"), report("one_of", "coulomb_friction", "cubic_stiffness"),
                   FAMILY)
    assert not either.facts["wrong_name"] and either.facts["in_set"]


def test_both_effects_stand_in_one_alternative_under_names_of_their_own():
    pair = entry("pair", "coulomb_friction", "input_delay")
    apart = {**report("one_of", "coulomb_friction", "input_delay"), "alternatives": [[0], [1]]}
    together = {**report("one_of", "coulomb_friction", "input_delay", "actuator_lag"), "alternatives": [[0, 1], [2]]}
    assert not judge("c", pair, apart, FAMILY).facts["both"]
    assert judge("c", pair, together, FAMILY).facts["both"]
    doubles = entry("pair", "coulomb_friction", "constant_load")
    for truth in doubles["effects"]:
        truth["equivalents"] = ["coulomb_friction", "constant_load"]
    assert not judge("c", doubles, report("named", "coulomb_friction"), FAMILY).facts["both"]
    assert judge("c", doubles, report("named", "constant_load", "coulomb_friction"), FAMILY).facts["both"]
