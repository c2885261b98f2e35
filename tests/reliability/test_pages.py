"""Names that are scripts change no element of a page, without a browser to ask."""

import pytest

from marl_clean.report import html
from tests.reliability.pages import Broken, Elements, check, page_of


def test_names_that_are_scripts_change_no_element() -> None:
    assert check().endswith("elements differ, 0 requests to other machines")


@pytest.mark.parametrize("place", ["escape", "as_script"])
def test_a_place_that_is_not_escaped_is_caught(monkeypatch: pytest.MonkeyPatch, place: str) -> None:
    monkeypatch.setattr(html, place, lambda text: str(text))
    with pytest.raises(Broken, match=" makes "):
        check()


def test_a_page_that_asks_another_machine_is_caught() -> None:
    def asking(*arguments: object) -> str:
        return html.render(*arguments).replace("<main>", '<main><img src="//x.org/a.png">')

    with pytest.raises(Broken, match=r"asks for <img src=//x\.org/a\.png>"):
        check(draw=asking)


def test_the_page_itself_forbids_requests_and_its_script_makes_none() -> None:
    page = page_of("name")
    assert "default-src 'none'" in page
    script = page.rpartition("<script>")[2]
    assert not any(word in script for word in ("fetch", "XMLHttpRequest", "import(", "WebSocket"))
    assert Elements(page).asks == []
