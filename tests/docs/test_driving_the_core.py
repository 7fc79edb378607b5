"""The session of docs/driving-the-core.md, run against the core."""

from __future__ import annotations

import doctest

from tests.docs.test_docs import ROOT


def test_the_session_of_the_page_is_what_the_core_does() -> None:
    page = (ROOT / "docs/driving-the-core.md").read_text().replace("```pycon", "").replace("```", "")
    examples = doctest.DocTestParser().get_doctest(page, {}, "driving-the-core", None, 0)
    runner = doctest.DocTestRunner(verbose=False)
    said = list[str]()
    runner.run(examples, out=said.append)
    assert runner.summarize(verbose=False).failed == 0, "".join(said)
    assert len(examples.examples) > 20
