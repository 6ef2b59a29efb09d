// Past calibrations of each arm: is it drifting, and when is the next one due?
// All text comes from a database, and is never interpreted as HTML.
//

const element = (name, words = "", kind = "") => {
  const made = document.createElement(name);
  if (words !== "") made.textContent = words;
  if (kind) made.className = kind;
  return made;
};
const drawn = (name, attributes, words = "") => {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (words) made.textContent = words;
  return made;
};
const number = (value, digits = 3) => (value === null || value === undefined ? "–" : value.toFixed(digits));
const day = utc => utc.slice(0, 10);

function status(trend, limit) {
  if (!trend) return ["not calibrated yet", "pill quiet"];
  if (trend.steps.length === 1) return ["first calibration", "pill"];
  const last = trend.steps.at(-1);
  if (!trend.can_tell) return ["cannot tell yet: 3 sigma exceeds the limit", "pill"];
  if (!trend.drifting) return ["no drift", "pill good"];
  const speed = trend.mm_per_year === null ? "" : `, ${trend.mm_per_year.toFixed(2)} mm a year`;
  return [`drifting${speed}${last.moved_mm > limit ? ", beyond the limit" : ""}`, "pill bad"];
}

function due(trend) {
  const line = element("p", "", "due");
  if (!trend?.due_utc) return line;
  const days = Math.round((Date.parse(trend.due_utc) - Date.now()) / 864e5);
  line.append("Next calibration due ", element("b", day(trend.due_utc)));
  line.append(days >= 0 ? ` (in ${days} days)` : ` (${-days} days ago)`);
  if (days < 0) line.classList.add("late");
  return line;
}

/** How far the arm has moved since its first calibration, with what is not known of it. */
function chart(trend, limit) {
  const [width, height, left, right, top, bottom] = [560, 150, 46, 14, 12, 24];
  const steps = trend.steps;
  const days = steps.at(-1).days || 1;
  const high = Math.max(limit, ...steps.map(s => s.moved_mm + 3 * s.sigma_mm)) * 1.12;
  const x = d => left + (d / days) * (width - left - right);
  const y = mm => height - bottom - (mm / high) * (height - top - bottom);
  const last = steps.at(-1);
  const picture = drawn("svg", {
    viewBox: `0 0 ${width} ${height}`, role: "img",
    "aria-label": `Moved ${last.moved_mm.toFixed(3)} mm since the first of ${steps.length} calibrations; the limit is ${limit} mm`,
  });
  for (const mm of [0, limit / 2, limit]) {
    picture.append(drawn("line", { x1: left, x2: width - right, y1: y(mm), y2: y(mm), stroke: mm === limit ? "var(--alarm)" : "var(--rule)", "stroke-dasharray": mm === limit ? "5 4" : "none" }));
    picture.append(drawn("text", { x: left - 6, y: y(mm) + 4, "text-anchor": "end" }, mm === 0 ? "0 mm" : mm.toFixed(2)));
  }
  picture.append(drawn("text", { x: width - right, y: y(limit) - 4, "text-anchor": "end" }, "limit"));
  picture.append(drawn("polyline", { points: steps.map(s => `${x(s.days)},${y(s.moved_mm)}`).join(" "), fill: "none", stroke: "var(--accent)", "stroke-width": 2 }));
  for (const s of steps) {
    picture.append(drawn("line", { x1: x(s.days), x2: x(s.days), y1: y(Math.max(0, s.moved_mm - 3 * s.sigma_mm)), y2: y(s.moved_mm + 3 * s.sigma_mm), stroke: "var(--accent)", "stroke-opacity": 0.45, "stroke-width": 3 }));
    const dot = drawn("circle", { cx: x(s.days), cy: y(s.moved_mm), r: 4, fill: "var(--accent)" });
    dot.append(drawn("title", {}, `run ${s.run}: ${s.moved_mm.toFixed(3)} mm since the first, 3 sigma ${(3 * s.sigma_mm).toFixed(3)} mm`));
    picture.append(dot);
  }
  picture.append(drawn("text", { x: left, y: height - 6 }, "first calibration"));
  picture.append(drawn("text", { x: width - right, y: height - 6, "text-anchor": "end" }, days < 2 ? `${(24 * days).toFixed(1)} hours later` : `${Math.round(days)} days later`));
  return picture;
}

function row(run) {
  const line = element("tr");
  const cell = content => { const made = element("td"); made.append(content); line.append(made); };
  cell(String(run.run));
  cell(run.created_utc.slice(0, 16).replace("T", " "));
  cell(run.trusted === null ? element("span", run.state, "tag none") : element("span", run.trusted ? "may be used" : "not to be used", run.trusted ? "tag" : "tag no"));
  cell(run.recorded === null ? "–" : String(run.recorded));
  cell(number(run.residual_rms_mm));
  cell(`${number(run.nominal_mm, 2)} → ${number(run.calibrated_mm, 2)}`);
  if (run.state === "running") cell("–");
  else {
    const link = element("a", "report");
    link.href = `/report/${run.run}`;
    link.setAttribute("aria-label", `Report of run ${run.run}`);
    cell(link);
  }
  return line;
}

function table(runs) {
  const made = element("table");
  const head = element("tr");
  for (const title of ["run", "begun (UTC)", "result", "poses", "rms (mm)", "error (mm)", ""]) head.append(element("th", title));
  made.append(element("thead"), element("tbody"));
  made.tHead.append(head);
  made.tBodies[0].append(...runs.map(row));
  const scroll = element("div", "", "scroll");
  scroll.append(made);
  return scroll;
}

const SHOWN = 6;

/** Asks the server for the past and shows it. */
export async function showPast() {
  const answer = await fetch("/api/history");
  if (!answer.ok) throw new Error(await answer.text());
  const past = await answer.json();
  const lead = document.getElementById("past-lead");
  if (!past.stored) lead.textContent = "This server has no database.";
  else if (!past.arms.length) lead.textContent = "No calibration is stored yet.";
  else lead.textContent = `How far each arm has moved since its first calibration, with three sigma. It must be calibrated again before it has moved by ${past.limit_mm} mm, and after a year.`;
  document.getElementById("arms").replaceChildren(...past.arms.map(arm => {
    const card = element("article", "", "card arm");
    const head = element("div", "", "head");
    head.append(element("h3", arm.arm ? `${arm.robot} ${arm.arm}` : arm.robot), element("span", ...status(arm.trend, past.limit_mm)));
    card.append(head, due(arm.trend));
    if (arm.trend && arm.trend.steps.length > 1) card.append(chart(arm.trend, past.limit_mm));
    const runs = arm.runs.toReversed();
    card.append(table(runs.slice(0, SHOWN)));
    if (runs.length > SHOWN) {
      const more = element("details");
      more.append(element("summary", `${runs.length - SHOWN} older`));
      // A fleet has thousands: rows are made when they are asked for.
      more.addEventListener("toggle", () => more.append(table(runs.slice(SHOWN))), { once: true });
      card.append(more);
    }
    return card;
  }));
  return past;
}
