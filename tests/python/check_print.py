"""Prints a report with headless Chromium on A4 and on Letter.

    check_print.py REPORT.html FOLDER

Writes a4.pdf and letter.pdf into FOLDER, and page one of each as a4.png and letter.png. Prints one
line of JSON: for each paper what is cut, the folded parts that are printed, the rows that may be
split, and the number of pages.
"""

import json
import os
import pathlib
import re
import shutil
import sys

from playwright.sync_api import sync_playwright

report = pathlib.Path(sys.argv[1]).resolve().as_uri()
folder = pathlib.Path(sys.argv[2])
folder.mkdir(parents=True, exist_ok=True)
browser_path = os.environ.get("SPHERECAL_CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")

# Paper in mm, and the margins of the page's own style.
PAPERS = {"a4": ("A4", 210.0, 297.0), "letter": ("Letter", 215.9, 279.4)}
SIDE, TOP, BOTTOM = 14.0, 13.0, 16.0
PX = 96.0 / 25.4

# What is wider than the paper, than its parent, or than the room that it has.
CUT = """width => {
  const out = [], name = e => e.tagName + '.' + e.className + ' ' + (e.textContent || '').trim().slice(0, 40);
  for (const e of document.querySelectorAll('main *')) {
    if (e.closest('svg') && e.tagName !== 'svg') continue;
    const box = e.getBoundingClientRect();
    if (!box.width || !box.height || e.tagName === 'INPUT') continue;
    if (box.right > width + 0.6 || box.left < -0.6) out.push(['paper', name(e), box.right - width]);
    if (e.scrollWidth > e.clientWidth + 1 && e.clientWidth && getComputedStyle(e).display !== 'inline') out.push(['room', name(e), e.scrollWidth - e.clientWidth]);
  }
  return out.slice(0, 12);
}"""
LOOK = """() => ({
  open: [...document.querySelectorAll('.folded')].filter(e => e.getBoundingClientRect().height).length,
  folds: document.querySelectorAll('.folded').length,
  split_rows: [...document.querySelectorAll('tr')].filter(e => getComputedStyle(e).breakInside !== 'avoid').length,
})"""

result = {}
with sync_playwright() as playwright:
    browser = playwright.chromium.launch(executable_path=browser_path, args=["--no-sandbox"])
    for name, (paper, width, height) in PAPERS.items():
        room = ((width - 2 * SIDE) * PX, (height - TOP - BOTTOM) * PX)
        page = browser.new_page(viewport={"width": int(room[0]), "height": int(room[1])})
        page.emulate_media(media="print")
        page.goto(report, wait_until="load")
        found = page.evaluate(LOOK)
        found["cut"] = page.evaluate(CUT, int(room[0]))
        page.screenshot(path=folder / f"{name}.png")
        pdf = folder / f"{name}.pdf"
        page.pdf(path=pdf, format=paper, print_background=True)
        found["pages"] = len(re.findall(rb"/Type\s*/Page\b", pdf.read_bytes()))
        result[name] = found
        page.close()
    browser.close()
print(json.dumps(result))
