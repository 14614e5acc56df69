"""A browser, where one is installed, in which tests look at pages."""

import os
import shutil

import pytest

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
HOSTILE = "<img src=//elsewhere.invalid/x><script>document.title='taken'</script>"
"""What somebody may write where text is asked for."""


@pytest.fixture(scope="module")
def browser():
    if CHROMIUM is None:
        pytest.skip("no Chromium is installed")
    with playwright.sync_playwright() as driver:
        found = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"] if os.getuid() == 0 else [])
        yield found
        found.close()


class Look:
    """A page, what it asked for, what it complained of, and what its scripts failed with."""

    def __init__(self, browser, size, **how):
        across, down = size
        self.page = browser.new_page(viewport={"width": across, "height": down}, **how)
        self.asked, self.complaints, self.errors = [], [], []
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.on("console", lambda message: self.complaints.append(message.text))
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))

    def find_violations(self):
        """What axe-core finds against accessibility: the rule, its impact, and where."""
        axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe-core is not installed")
        found = axe.Axe().run(self.page).response["violations"]
        return [f"{rule['id']} ({rule['impact']}): {place['html'][:80]}" for rule in found for place in rule["nodes"]]

    def find_beyond(self, side, shown, within_px=0.5):
        """What lies, of the elements that a selector finds, beyond the page in x, to the left or right, or in y."""
        return self.page.evaluate(
            """([side, shown, by]) => {
                const [begins, ends, scroll, inner] = side === "x"
                    ? ["left", "right", "scrollWidth", innerWidth] : ["top", "bottom", "scrollHeight", innerHeight];
                const beyond = [...document.querySelectorAll(shown)].filter(each => {
                    const box = each.getBoundingClientRect();
                    return each.checkVisibility() && (box[begins] < -by || box[ends] > inner + by || !box.width);
                }).map(each => each.outerHTML.slice(0, 80));
                return document.documentElement[scroll] > inner ? [`page is larger in ${side}`, ...beyond] : beyond;
            }""",
            [side, shown, within_px],
        )
