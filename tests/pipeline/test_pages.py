"""Pages as a browser shows them: on a wide screen and on a phone, with nothing asked for elsewhere."""

import pytest

from tests import browsing
from tests.browsing import HOSTILE
from tests.browsing import browser as browser
from tests.conftest import Command
from tests.pipeline.conftest import ALONE, CONFIG

pytestmark = pytest.mark.slow
WIDTHS = {"wide": (1280, 900), "phone": (390, 844)}


@pytest.fixture(scope="module")
def pages(browser, tmp_path_factory):
    """Paths of pages of every kind, by name."""
    command = Command(tmp_path_factory.mktemp("pages") / "outputs", *CONFIG)
    swept = command("workflow=trials", *ALONE, "sweep=s", "seed=0,1,2", "counting.count=3,9", "trying.fail_at=[1]")
    assert swept.returncode == 1, swept.stderr
    assert command("workflow=toy", f'counting.label="{HOSTILE}"').returncode == 0
    assert command("workflow=toy", "doubling.fail_at=3").returncode == 1
    assert command.review("sweep", "s").returncode == 0
    assert command.review("compare", "s", *(each.name for each in command.runs)).returncode == 0
    (comparison,) = (command.outputs / "reviews").iterdir()
    report, failure = (run / "report.html" for run in command.runs)
    sweep = command.outputs / "sweeps" / "s" / "sweep.html"
    return {"sweep": sweep, "comparison": comparison, "report": report, "failure": failure}


def open_page(browser, path):
    """Return a page opened without network."""
    look = browsing.Look(browser, WIDTHS["wide"], offline=True)
    look.page.goto(path.as_uri())
    return look


@pytest.mark.parametrize("kind", ["sweep", "comparison", "report", "failure"])
def test_page_stands_alone_and_fits(pages, browser, kind):
    look = open_page(browser, pages[kind])
    assert {each for each in look.asked if not each.startswith("data:")} == {pages[kind].as_uri()}
    assert look.page.title() != "taken"
    for across, down in WIDTHS.values():
        look.page.set_viewport_size({"width": across, "height": down})
        assert look.find_beyond("x", "h1, h2, h3, p, dd, li, img, pre, .scroll, .failure", within_px=0.0) == []
    pictures = look.page.evaluate("[...document.images].map(each => [each.naturalWidth > 0, each.alt !== ''])")
    assert all(drawn and told for drawn, told in pictures)
    assert bool(pictures) == (kind != "failure")
    anchors = look.page.evaluate("[...document.querySelectorAll('nav a')].map(each => each.hash.slice(1))")
    assert anchors
    assert look.page.evaluate("names => names.filter(each => !document.getElementById(each))", anchors) == []
    assert look.complaints + look.errors == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("kind", ["sweep", "comparison", "report", "failure"])
def test_page_is_accessible(pages, browser, kind, scheme):
    look = browsing.Look(browser, WIDTHS["wide"], offline=True, color_scheme=scheme)
    look.page.goto(pages[kind].as_uri())
    look.page.evaluate("document.querySelectorAll('details').forEach(each => { each.open = true })")
    assert look.find_violations() == []
    look.page.close()


def test_a_request_to_elsewhere_is_refused(pages, browser, tmp_path):
    """The page's own rules, and not the lack of network, keep it to itself."""
    page = tmp_path / "page.html"
    page.write_text(pages["report"].read_text().replace("</body>", f'<img src="{(tmp_path / "x").as_uri()}"></body>'))
    look = open_page(browser, page)
    assert any("Content Security Policy" in each for each in look.complaints)


def test_jobs_are_sorted_and_filtered_and_lead_to_their_reports(pages, browser):
    def cells(column):
        return look.page.locator(f"table.sortable tbody tr:visible td:nth-child({column + 1})").all_inner_texts()

    look = open_page(browser, pages["sweep"])
    heads = look.page.locator("table.sortable thead th").all_inner_texts()
    score = heads.index("score_m")
    button = look.page.locator("table.sortable thead button").nth(score)
    button.click()
    rising = cells(score)
    numbers = [float(each) for each in rising[:4]]
    assert numbers == sorted(numbers)
    assert rising[4:] == ["-", "-"]
    button.click()
    assert cells(score) == [*reversed(rising[:4]), "-", "-"]
    look.page.get_by_role("searchbox").fill("failed count=9")
    assert len(cells(0)) == 1
    assert look.page.get_by_text("1 of 6 rows").is_visible()
    look.page.locator("table.sortable tbody a:visible").click()
    look.page.wait_for_url("**/report.html")
    assert look.page.get_by_text("ArithmeticError: cannot try 1").first.is_visible()
