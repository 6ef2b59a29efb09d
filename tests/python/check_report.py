"""Opens a report in headless Chromium: light, dark and as printed.

    check_report.py REPORT.html FOLDER [WIDTH]

Writes light.png, dark.png, print.png and top-light.png, top-dark.png into
FOLDER. Prints one line of JSON: requests beyond the file itself, errors of the
page, what is wider than the page, headings, figures, and contrast of the body.
"""

import json
import os
import pathlib
import shutil
import sys

from playwright.sync_api import sync_playwright

report = pathlib.Path(sys.argv[1]).resolve().as_uri()
folder = pathlib.Path(sys.argv[2])
width = int(sys.argv[3]) if len(sys.argv) > 3 else 1000
folder.mkdir(parents=True, exist_ok=True)
browser_path = os.environ.get("SPHERECAL_CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")

CONTRAST = """() => {
  const lum = c => { const v = c.match(/[\\d.]+/g).slice(0, 3).map(x => { x /= 255; return x <= 0.03928 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4; }); return 0.2126 * v[0] + 0.7152 * v[1] + 0.0722 * v[2]; };
  const back = getComputedStyle(document.body).backgroundColor;
  const a = lum(getComputedStyle(document.body).color), b = lum(back === 'rgba(0, 0, 0, 0)' ? 'rgb(255, 255, 255)' : back);
  return (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
}"""

requests, errors, result = [], [], {}
with sync_playwright() as playwright:
    browser = playwright.chromium.launch(executable_path=browser_path, args=["--no-sandbox"])
    for scheme in ["light", "dark", "print"]:
        context = browser.new_context(
            viewport={"width": width, "height": 900}, color_scheme="dark" if scheme == "dark" else "light"
        )
        page = context.new_page()
        page.on("request", lambda r: requests.append(r.url) if r.url != report and not r.url.startswith("data:") else None)
        page.on("console", lambda m: errors.append(m.text) if m.type in ("error", "warning") else None)
        page.on("pageerror", lambda e: errors.append(str(e)))
        page.goto(report, wait_until="load")
        if scheme == "print":
            page.emulate_media(media="print")
        page.screenshot(path=folder / f"{scheme}.png", full_page=True)
        if scheme != "print":
            page.screenshot(path=folder / f"top-{scheme}.png")
            result[f"contrast_{scheme}"] = page.evaluate(CONTRAST)
        if scheme == "light":
            result["headings"] = page.eval_on_selector_all("h2", "all => all.map(e => e.innerText)")
            result["figures"] = page.eval_on_selector_all("figure svg", "all => all.length")
            result["empty_figures"] = page.eval_on_selector_all(
                "figure svg", "all => all.filter(e => !e.closest('.folded')).filter(e => e.getBoundingClientRect().height < 40 || e.childElementCount < 3).length"
            )
            result["too_wide"] = page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
        context.close()
    browser.close()
result["requests"], result["errors"] = requests, errors
print(json.dumps(result))
