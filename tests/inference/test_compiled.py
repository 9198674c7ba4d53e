"""A process near its limit of mappings lets go of compiled code."""

import os

import compiling
import jax
import pytest

from jbw.inference import compiled


@pytest.mark.parametrize(("mappings", "forgets"), [(5, False), (7, True)])
def test_it_forgets_before_the_limit(mappings, forgets, tmp_path, monkeypatch):
    cleared = []
    monkeypatch.setattr(jax, "clear_caches", lambda: cleared.append(True))
    (tmp_path / "maps").write_text("7f00-7f01 r-xp\n" * mappings)
    (tmp_path / "limit").write_text("10\n")
    monkeypatch.setattr(compiled, "MAPS", tmp_path / "maps")
    monkeypatch.setattr(compiled, "LIMIT", tmp_path / "limit")
    assert compiled.forget_when_many() is forgets
    assert bool(cleared) is forgets


@pytest.mark.parametrize(("pages", "forgets"), [(5, False), (6, True)])
def test_it_forgets_when_a_process_is_large(pages, forgets, tmp_path, monkeypatch):
    cleared = []
    monkeypatch.setattr(jax, "clear_caches", lambda: cleared.append(True))
    (tmp_path / "pages").write_text(f"999 {pages} 3 1 0 2 0\n")
    monkeypatch.setattr(compiling, "PAGES", tmp_path / "pages")
    monkeypatch.setattr(os, "sysconf", {"SC_PAGE_SIZE": 4096}.get)
    assert compiling.forget_when_large(5 * 4096) is forgets
    assert bool(cleared) is forgets


def test_a_machine_that_does_not_count_keeps_all(tmp_path, monkeypatch):
    monkeypatch.setattr(compiled, "MAPS", tmp_path / "none")
    monkeypatch.setattr(compiling, "PAGES", tmp_path / "none")
    assert compiled.forget_when_many() is False
    assert compiling.forget_when_large(0.0) is False
