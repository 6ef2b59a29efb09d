// The page: hears of the runs, and shows the one that is chosen.
import { ArmView, tcp } from "/arm.js";
import { plot } from "/plots.js";
import { showPast } from "/past.js";

const at = id => document.getElementById(id);
const STAGES = { connect: "connecting", home: "going home", plate: "waiting for the plate", teach: "teaching", approach: "approaching", couple: "touching", poses: "recording", decouple: "leaving", recover: "recovering", done: "done" };
const PHASES = { idle: "idle", moving: "moving", taring: "taring", approaching: "descending", coupling: "coupling", verifying: "test pull", coupled: "coupled", turning: "turning", recording: "recording", decoupling: "decoupling", hand_guiding: "hand-guiding", impedance: "impedance", fault: "fault" };
/** Seconds of robot time on the force's curve. */
const SPAN = 30;

/** What is known of each run, by its id. */
const runs = new Map();
let chosen = null;
let byHand = false;
let dirty = true;
/** Whether the server has said that it ends, as that of a run does with the run. */
let closed = false;
const view = new ArmView(at("arm"));
const calm = matchMedia("(prefers-reduced-motion: reduce)");

function hear({ id, message: told }) {
  const [kind, message] = Object.entries(told)[0];
  if (kind === "scene") {
    // An arm that begins anew takes the place of its last run.
    for (const old of runs.values()) {
      if (old.end && old.scene.robot === message.robot && old.scene.arm === message.arm) runs.delete(old.id);
    }
    runs.set(id, { id, scene: message, frame: null, forces: [], contact: null, notes: [], end: null, q: [...message.home_rad], frames: 0 });
    if (!byHand || !runs.has(chosen) || runs.get(chosen).end) {
      chosen = id;
      byHand = false;
    }
    tabs();
    return;
  }
  const run = runs.get(id);
  if (!run) return;
  if (kind === "frame") {
    run.frame = message;
    run.frames += 1;
    run.forces.push(...message.forces);
    const oldest = (run.forces.at(-1)?.[0] ?? 0) - SPAN;
    if (run.forces.length && run.forces[0][0] < oldest - 5) run.forces = run.forces.filter(p => p[0] >= oldest);
  } else if (kind === "contact") run.contact = message;
  else if (kind === "note") run.notes.unshift(message.text);
  else if (kind === "end") {
    run.end = message;
    tabs();
    setTimeout(past, 400);
  }
  dirty = true;
}

/** One button for each run, where there are several. */
function tabs() {
  const all = [...runs.values()];
  at("runs").replaceChildren(...(all.length < 2 ? [] : all).map(run => {
    const button = document.createElement("button");
    button.textContent = `${run.scene.robot} ${run.scene.arm || `#${run.id}`}${run.end ? " (ended)" : ""}`;
    button.setAttribute("aria-pressed", String(run.id === chosen));
    button.addEventListener("click", () => { chosen = run.id; byHand = true; tabs(); });
    return button;
  }));
  dirty = true;
}

const clock = s => (s >= 3600 ? `${Math.floor(s / 3600)}:${String(Math.floor(s / 60) % 60).padStart(2, "0")}` : Math.floor(s / 60)) + `:${String(Math.floor(s % 60)).padStart(2, "0")}`;
const say = (id, words) => { const e = at(id); if (e.textContent !== words) e.textContent = words; };

function describe(run) {
  const { scene, frame, end } = run;
  // The two links whose arm is in the program itself, and a drive that says so.
  const simulated = ["sim", "qemu"].includes(scene.link) || frame?.simulated ? "SIMULATED: " : "";
  say("name", simulated + (scene.arm ? `${scene.robot} ${scene.arm}` : scene.robot));
  say("about", `${frame && !end ? `${STAGES[frame.stage]}, ` : ""}link ${scene.link}, begun ${scene.begun_utc.slice(11, 16)} UTC`);
  const phase = end ? (end.trusted === null ? "ended" : end.trusted ? "may be used" : "not to be used") : frame ? PHASES[frame.phase] : "starting";
  say("phase", phase);
  at("phase").className = `pill phase ${end ? (end.trusted ? "good" : "bad") : frame?.phase === "fault" ? "bad" : ""}`;
  document.title = `${simulated}${phase}, ${scene.robot} ${scene.arm} – spherecal`;
  at("arm").setAttribute("aria-label", `${scene.robot} ${scene.arm}: ${phase}`);
  if (!frame) return;
  say("done", String(frame.done));
  say("poses", String(frame.poses));
  const bar = at("bar");
  bar.setAttribute("aria-valuemax", frame.poses);
  bar.setAttribute("aria-valuenow", frame.done);
  bar.firstElementChild.style.width = `${frame.poses ? (100 * frame.done) / frame.poses : 0}%`;
  say("eta", frame.eta_s === null ? "–" : end ? "0:00" : clock(frame.eta_s));
  say("sphere", frame.sphere ? String(frame.sphere) : "–");
  say("contacts", String(frame.contacts));
  say("faults", String(frame.faults));
  at("faults").className = frame.faults ? "bad" : "";
  say("residual", frame.residual_mm === null ? "–" : `${frame.residual_mm.toFixed(2)} mm`);
  say("time", `${clock(frame.device_s)} (${(frame.device_s / Math.max(frame.wall_s, 0.1)).toFixed(0)}×)`);
  say("force", frame.force_is_vague ? "unknown near a singular posture" : `${(run.forces.at(-1)?.[1] ?? 0).toFixed(1)} N`);
  say("last-contact", run.contact ? `sphere ${run.contact.trace.sphere}: ${run.contact.force_n.toFixed(1)} N after ${run.contact.travel_mm.toFixed(1)} mm` : "none yet");
  realTime(frame.real_time);
  joints(run);
}

/** The histograms of the real-time loop; only a run over a robot's own interface has them. */
function realTime(times) {
  at("realtime").hidden = !times;
  if (!times) return;
  const { cycles, late, missed, turnaround, jitter } = times;
  say("realtime-words", `${cycles} cycles, ${((100 * late) / Math.max(cycles, 1)).toFixed(3)} % answered later than 300 µs, ${missed} periods missed. From state to command ${turnaround.median_us} µs (median), ${turnaround.most_us} µs (99.9 %), ${turnaround.max_us} µs (longest).`);
  const counts = new Map();
  [turnaround, jitter].forEach((spread, column) => spread.octaves.forEach(([beyond, count]) => {
    counts.set(beyond, counts.get(beyond) ?? [0, 0]);
    counts.get(beyond)[column] = count;
  }));
  const rows = [...counts].sort((a, b) => a[0] - b[0]);
  const body = at("times").tBodies[0];
  while (body.rows.length > rows.length) body.deleteRow(-1);
  rows.forEach(([beyond, values], k) => {
    const line = body.rows[k] ?? body.insertRow();
    while (line.cells.length < 3) line.insertCell();
    [beyond, ...values].forEach((value, c) => { line.cells[c].textContent = String(value); });
  });
}

function joints({ scene, frame }) {
  const body = at("joints").tBodies[0];
  if (body.rows.length !== scene.joints.length) {
    body.replaceChildren(...scene.joints.map((_, k) => {
      const line = document.createElement("tr");
      for (let c = 0; c < 4; c += 1) line.append(document.createElement("td"));
      line.cells[0].textContent = String(k + 1);
      const range = document.createElement("span");
      range.className = "range";
      range.append(document.createElement("i"));
      line.cells[2].append(range);
      return line;
    }));
  }
  const deg = 180 / Math.PI;
  scene.joints.forEach((joint, k) => {
    const cells = body.rows[k].cells;
    const q = frame.q[k];
    cells[1].textContent = q === undefined ? "–" : `${(q * deg).toFixed(1)}°`;
    const share = q === undefined ? 0.5 : (q - joint.min_rad) / (joint.max_rad - joint.min_rad);
    cells[2].firstElementChild.firstElementChild.style.left = `${100 * Math.min(1, Math.max(0, share))}%`;
    cells[2].title = `${(joint.min_rad * deg).toFixed(0)}° to ${(joint.max_rad * deg).toFixed(0)}°`;
    cells[3].textContent = frame.tau[k] === undefined ? "–" : `${frame.tau[k].toFixed(1)} N m`;
  });
}

function remarks(run) {
  const list = at("notes");
  if (list.childElementCount !== run.notes.length || list.firstElementChild?.textContent !== run.notes[0]) {
    list.replaceChildren(...run.notes.map(text => { const item = document.createElement("li"); item.textContent = text; return item; }));
  }
  const end = at("end");
  end.hidden = !run.end;
  const shown = `${run.id} ${closed}`;
  if (!run.end || end.dataset.of === shown) return;
  end.dataset.of = shown;
  end.className = `verdict ${run.end.trusted === null ? "" : run.end.trusted ? "good" : "bad"}`;
  end.textContent = run.end.text.trim();
  if (closed) end.append("\nThis page has ended with its server; report.html is in the run's folder.");
  else if (run.end.run !== null && run.end.trusted !== null) {
    const link = document.createElement("a");
    link.href = `/report/${run.end.run}`;
    link.textContent = `Report of run ${run.end.run}`;
    end.append(document.createElement("br"), link);
  }
}

let last = 0;
function draw(now) {
  requestAnimationFrame(draw);
  const run = runs.get(chosen);
  at("now").hidden = !run;
  at("idle").hidden = Boolean(run);
  if (!run) return;
  // The arm glides from one frame to the next.
  const share = calm.matches ? 1 : 1 - Math.exp(-(now - last) / 70);
  last = now;
  const target = run.frame?.q.length ? run.frame.q : run.scene.home_rad;
  let moves = false;
  run.q = target.map((q, k) => {
    const next = run.q[k] + (q - run.q[k]) * share;
    moves ||= Math.abs(q - next) > 2e-4;
    return Math.abs(q - next) > 2e-4 ? next : q;
  });
  if (!dirty && !moves && !view.dirty) return;
  if (dirty || moves) view.show(run.scene, run.frame, run.q);
  view.draw();
  if (!dirty) return;
  dirty = false;
  describe(run);
  remarks(run);
  const newest = run.forces.at(-1)?.[0] ?? 0;
  plot(at("curve"), run.forces, { t0: newest - SPAN, t1: newest, threshold: run.scene.trigger_n, label: t => clock(Math.max(0, t)) });
  const trace = run.contact?.trace;
  const sinceTrigger = (trace?.samples ?? []).map(([time, force]) => [time - trace.trigger_s, force]);
  plot(at("contact"), sinceTrigger, { t0: -1, t1: 0.5, threshold: run.scene.trigger_n, trigger: run.contact ? [0, run.contact.force_n] : null, label: t => `${+t.toFixed(2)} s` });
}

function line(words, kind) {
  say("line", words);
  at("line").className = `pill ${kind}`;
}

async function past() {
  if (closed) return;
  try {
    window.spherecal.past = await showPast();
  } catch (error) {
    at("past-lead").textContent = `The past cannot be shown: ${error.message}`;
  }
}

function listen() {
  const source = new EventSource("/api/live");
  source.addEventListener("anew", () => {
    runs.clear();
    tabs();
    line("connected", "good");
  });
  source.onmessage = event => hear(JSON.parse(event.data));
  source.addEventListener("closed", () => {
    source.close();
    closed = true;
    dirty = true;
    line("the server has ended", "quiet");
  });
  source.onerror = () => line("no connection, trying again", "bad");
}

// For whoever looks from a console or a test.
window.spherecal = { runs, tcp, get chosen() { return runs.get(chosen); } };
at("how").textContent = `spherecal run --publish ${location.protocol === "https:" ? "grpcs" : "grpc"}:${location.host}`;
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { dirty = true; });
addEventListener("resize", () => { dirty = true; });
listen();
past();
requestAnimationFrame(draw);
