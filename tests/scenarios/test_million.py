"""Mass simulation of descents on a small number."""

from __future__ import annotations

import re

import pytest


def test_failure_rates_are_printed_also_after_an_interrupt(script, monkeypatch, capsys):
    study = script(".", "million")
    monkeypatch.setattr("sys.argv", ["million.py", "--flights", "150", "--worlds", "1"])
    assert study.main() == 0
    whole = capsys.readouterr().out
    assert whole.startswith("150 descents of ")
    failed = int(re.search(r"not safe +(\d+)", whole).group(1))
    assert 0 < failed < 30

    batches = study.batches

    def cut(scenario, flights, seed, worlds):
        if flights == 64:  # the compilation run
            yield from batches(scenario, flights, seed, worlds)
            return
        yield next(batches(scenario, flights, seed, worlds, lanes=70))
        raise KeyboardInterrupt

    monkeypatch.setattr(study, "batches", cut)
    assert study.main() == 130
    told = capsys.readouterr()
    assert told.out.startswith("70 descents of ")
    assert "interrupted: the results cover the flights until then" in told.err


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--flights", "0"], "--flights: must be 1 or more, got 0"),
        (["--seed", "-1"], "must be 0 or more"),
        (["--scenario", "hardd"], "hard"), (["--step", "nan"], "step_s"),
        (["--worlds", "0"], "--worlds: must be 1 or more, got 0"),
    ],
)  # fmt: skip
def test_invalid_input_is_rejected(script, monkeypatch, capsys, words, says):
    study = script(".", "million")
    monkeypatch.setattr("sys.argv", ["million.py", *words])
    assert study.main() == 2
    assert says in capsys.readouterr().err
