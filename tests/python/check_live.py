"""Watches a run on the page of `spherecal serve`, in headless Chromium.

    check_live.py URL FOLDER WIDTH COMMAND...     starts COMMAND (a run) once the page stands, and looks until it ends
    check_live.py --login URL TOKEN               is let in with the token, and not without

Writes live-light.png, live-dark.png, contact.png, end.png and past.png into
FOLDER. Prints one line of JSON: what was seen.
"""

import json
import os
import pathlib
import shutil
import subprocess
import sys
import time
from urllib.parse import urlsplit

from playwright.sync_api import sync_playwright

browser_path = os.environ.get("SPHERECAL_CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")
requests, errors, result = [], [], {}

# What the page knows of the run that it shows.
LOOK = """() => {
  const run = spherecal.chosen;
  if (!run) return null;
  const f = run.frame;
  const tcp = f && f.q.length ? spherecal.tcp(run.scene, f.q) : null;
  return { id: run.id, frames: run.frames, phase: f && f.phase, stage: f && f.stage, done: f && f.done, q: f && f.q, shown: run.q, points: run.forces.length,
    residual: f && f.residual_mm, contact: run.contact && run.contact.trace.samples.length, end: run.end && run.end.text,
    tcp_off_mm: tcp && 1e3 * Math.hypot(...tcp.map((v, k) => v - f.tcp_m[k])),
    words: { done: document.getElementById('done').textContent, phase: document.getElementById('phase').textContent } };
}"""
# How many colours a canvas has: an empty one has one.
PAINTED = """id => {
  const c = document.getElementById(id), d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data, seen = new Set();
  for (let k = 0; k < d.length; k += 4) seen.add(d[k] << 16 | d[k + 1] << 8 | d[k + 2] | d[k + 3] << 24);
  return seen.size;
}"""
CONTRAST = """() => {
  const lum = c => { const v = c.match(/[\\d.]+/g).slice(0, 3).map(x => { x /= 255; return x <= 0.03928 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4; }); return 0.2126 * v[0] + 0.7152 * v[1] + 0.0722 * v[2]; };
  const ground = e => { for (; e; e = e.parentElement) { const c = getComputedStyle(e).backgroundColor; if (!/, 0\\)$/.test(c)) return c; } return 'rgb(255, 255, 255)'; };
  return Math.min(...[...document.querySelectorAll('body, dt, dd, th, td, h2, h3, .pill, .lead, figcaption, .tag, .due')].filter(e => e.offsetParent).map(e => {
    const a = lum(getComputedStyle(e).color), b = lum(ground(e));
    return (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
  }));
}"""
NAMELESS = """() => [...document.querySelectorAll('canvas, svg, img, button, a, [role=progressbar]')].filter(e => e.offsetParent !== null || e.tagName === 'svg')
  .filter(e => !(e.getAttribute('aria-label') || e.textContent.trim() || (e.tagName === 'IMG' && e.hasAttribute('alt')))).map(e => e.outerHTML.slice(0, 80))"""


def open_page(context, url):
    page = context.new_page()
    host = urlsplit(url).netloc
    page.on("request", lambda r: requests.append(r.url) if urlsplit(r.url).netloc != host else None)
    page.on("console", lambda m: errors.append(m.text) if m.type in ("error", "warning") else None)
    page.on("pageerror", lambda e: errors.append(str(e)))
    return page


def login(browser, url, token):
    context = browser.new_context(ignore_https_errors=True)
    page = context.new_page()
    result["first"] = page.goto(url).status
    result["history"] = page.evaluate("fetch('/api/history').then(r => r.status)")
    for word in ["0" * len(token), token]:
        page.fill("#token", word)
        page.click("button")
        page.wait_for_timeout(800)
        result["wrong" if word != token else "right"] = page.title()
    page.wait_for_selector("#past-lead:not(:empty)")
    result["inside"] = page.evaluate("fetch('/api/history').then(r => r.status)")
    result["secrets"] = page.evaluate("document.cookie")


def watch(browser, url, folder, width, command):
    folder.mkdir(parents=True, exist_ok=True)
    context = browser.new_context(viewport={"width": width, "height": 1000}, color_scheme="light")
    page = open_page(context, url)
    page.goto(url, wait_until="load")
    page.wait_for_selector("#past-lead:not(:empty)")
    page.wait_for_selector("#idle:not([hidden]), #now:not([hidden])")
    # The page may still show a run that has ended.
    before = page.evaluate(LOOK)
    result["arms_before"] = page.locator(".arm").count()
    result["rows_before"] = page.locator(".arm tbody tr").count()
    result["arm_words"] = page.locator("#arms").inner_text()
    run = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    seen, shots = [], set()
    # The run takes minutes on a machine with other work. The page has a minute more to show its end.
    until = time.monotonic() + 900
    while time.monotonic() < until:
        if run.poll() is not None:
            until = min(until, time.monotonic() + 60)
        state = page.evaluate(LOOK)
        if state and not (before and state["id"] == before["id"]):
            seen.append(state)
            if state["phase"] == "recording" and state["done"] and state["done"] > 3 and "live" not in shots:
                shots.add("live")
                result["painted"] = {name: page.evaluate(PAINTED, name) for name in ["arm", "curve", "contact"]}
                result["nameless"] = page.evaluate(NAMELESS)
                for scheme in ["light", "dark"]:
                    page.emulate_media(color_scheme=scheme)
                    page.wait_for_timeout(150)
                    result[f"contrast_{scheme}"] = page.evaluate(CONTRAST)
                    page.screenshot(path=folder / f"live-{scheme}.png")
                page.emulate_media(color_scheme="light")
            if state["phase"] == "coupling" and "contact" not in shots and len(seen) > 10:
                shots.add("contact")
                page.screenshot(path=folder / "contact.png")
            if state["end"]:
                break
        page.wait_for_timeout(30)
    result["exit"] = run.wait(60)
    result["said"] = run.stderr.read().decode()[-2000:]
    moving = [s for s in seen if s["q"]]
    if not moving:
        sys.exit(f"no joint angles in {len(seen)} looks at the page; the run said: {result['said']}")
    result["frames"] = seen[-1]["frames"] if seen else 0
    result["phases"] = sorted({s["phase"] for s in moving})
    result["moved_rad"] = max(max(s["q"][k] for s in moving) - min(s["q"][k] for s in moving) for k in range(len(moving[0]["q"])))
    result["shown_rad"] = max(max(s["shown"][k] for s in moving) - min(s["shown"][k] for s in moving) for k in range(len(moving[0]["q"])))
    result["tcp_off_mm"] = max(s["tcp_off_mm"] for s in moving)
    result["points"] = max(s["points"] for s in seen)
    result["contact"] = max(s["contact"] or 0 for s in seen)
    result["done"] = sorted({s["done"] for s in moving})
    result["words"] = sorted({s["words"]["done"] for s in moving}, key=int)
    result["residual"] = seen[-1]["residual"]
    result["end"] = seen[-1]["end"]
    page.wait_for_function("n => document.querySelectorAll('.arm tbody tr').length > n", arg=result["rows_before"])
    page.wait_for_timeout(300)
    page.screenshot(path=folder / "end.png")
    page.screenshot(path=folder / "whole.png", full_page=True)
    page.locator("#past").screenshot(path=folder / "past.png")
    result["rows_after"] = page.locator(".arm tbody tr").count()
    result["too_wide"] = page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
    page.locator("#end a").click()
    page.wait_for_load_state("load")
    result["report"] = page.eval_on_selector_all("h2", "all => all.map(e => e.innerText)")
    context.close()


with sync_playwright() as playwright:
    browser = playwright.chromium.launch(executable_path=browser_path, args=["--no-sandbox"])
    if sys.argv[1] == "--login":
        login(browser, sys.argv[2], sys.argv[3])
    else:
        watch(browser, sys.argv[1], pathlib.Path(sys.argv[2]), int(sys.argv[3]), sys.argv[4:])
    browser.close()
result["requests"], result["errors"] = requests, errors
print(json.dumps(result))
