// The force over time, and around the last contact.

/** A canvas in the pixels of the screen, cleared; `null` while it has no size. */
function sheet(canvas) {
  const ratio = Math.min(2, devicePixelRatio || 1);
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  const [w, h] = [Math.round(width * ratio), Math.round(height * ratio)];
  if (!w || !h) return null;
  if (canvas.width !== w || canvas.height !== h) Object.assign(canvas, { width: w, height: h });
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  pen.font = "12px system-ui, sans-serif";
  return { pen, width, height };
}

function step(span, parts) {
  const raw = span / parts;
  const power = 10 ** Math.floor(Math.log10(raw));
  return [1, 2, 5, 10].find(m => raw <= m * power) * power;
}

/**
 * Draws points [t, N] between t0 and t1 (s), with the threshold as a line and
 * the trigger, where there is one, as a mark.
 */
export function plot(canvas, points, { t0, t1, threshold, trigger, label }) {
  const on = sheet(canvas);
  if (!on) return;
  const { pen, width, height } = on;
  const style = getComputedStyle(document.documentElement);
  const colour = name => style.getPropertyValue(name).trim();
  const [left, right, top, bottom] = [42, 8, 8, 22];
  const shown = points.filter(p => p[0] >= t0 && p[0] <= t1);
  const peak = shown.reduce((most, p) => Math.max(most, p[1]), 0);
  // Letting go of a magnet takes ten times the force of a touch: it is said, and not drawn to its end.
  const high = Math.min(Math.max(threshold * 1.35, peak * 1.1), threshold * 4);
  const x = t => left + ((t - t0) / (t1 - t0)) * (width - left - right);
  const y = n => height - bottom - (Math.max(Math.min(n, high), -high / 20) / high) * (height - top - bottom);
  pen.lineWidth = 1;
  pen.textAlign = "right";
  pen.textBaseline = "middle";
  for (let n = 0, by = step(high, 4); n <= high; n += by) {
    pen.strokeStyle = colour("--rule");
    pen.beginPath();
    pen.moveTo(left, y(n));
    pen.lineTo(width - right, y(n));
    pen.stroke();
    pen.fillStyle = colour("--soft");
    pen.fillText(`${+n.toFixed(2)} N`, left - 5, y(n));
  }
  pen.textBaseline = "alphabetic";
  pen.textAlign = "center";
  for (let by = step(t1 - t0, 6), t = Math.ceil(t0 / by) * by; t <= t1; t += by) {
    pen.fillText(label(t), Math.min(width - right - 14, Math.max(left + 10, x(t))), height - 6);
  }
  if (shown.length > 1) {
    const line = new Path2D();
    shown.forEach(([t, n], k) => (k ? line.lineTo(x(t), y(n)) : line.moveTo(x(t), y(n))));
    const area = new Path2D(line);
    area.lineTo(x(shown.at(-1)[0]), y(0));
    area.lineTo(x(shown[0][0]), y(0));
    pen.globalAlpha = 0.14;
    pen.fillStyle = colour("--accent");
    pen.fill(area);
    pen.globalAlpha = 1;
    pen.strokeStyle = colour("--accent");
    pen.lineWidth = 1.6;
    pen.lineJoin = "round";
    pen.stroke(line);
  }
  pen.strokeStyle = colour("--orange");
  pen.lineWidth = 1.3;
  pen.setLineDash([5, 4]);
  pen.beginPath();
  pen.moveTo(left, y(threshold));
  pen.lineTo(width - right, y(threshold));
  pen.stroke();
  pen.setLineDash([]);
  pen.fillStyle = colour("--orange");
  pen.textAlign = "left";
  pen.fillText("trigger", left + 4, y(threshold) - 4);
  if (peak > high) {
    pen.fillStyle = colour("--soft");
    pen.textAlign = "right";
    pen.fillText(`peak ${peak.toFixed(0)} N`, width - right - 2, top + 11);
  }
  if (trigger) {
    const [t, n] = trigger;
    pen.strokeStyle = pen.fillStyle = colour("--alarm");
    pen.lineWidth = 1.3;
    pen.beginPath();
    pen.moveTo(x(t), top);
    pen.lineTo(x(t), height - bottom);
    pen.stroke();
    pen.beginPath();
    pen.arc(x(t), y(n), 4.5, 0, 7);
    pen.fill();
  }
}
