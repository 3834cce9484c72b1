// Backgrounds of time figures: standstill shading, intervals, further lines.

import { colour } from "../plots.js";

/** A grey ground wherever `standing` is true of the times `x`. */
export function shade(one, x, standing) {
  const stretches = [];
  for (let first = 0; first < x.length; first++) {
    if (standing[first] !== true) continue;
    let last = first;
    while (standing[last + 1] === true) last++;
    stretches.push([x[first], x[last]]);
    first = last;
  }
  shadeStretches(one, stretches, colour("standing"));
}

/** A ground of that colour over intervals of time, [from, to] each. */
export function shadeStretches(one, stretches, fill) {
  if (!isReady(one)) return;
  const { left, top, width, height } = one.bbox;
  one.ctx.save();
  one.ctx.fillStyle = fill;
  for (const ends of stretches) {
    const [from, to] = ends.map((time) => Math.min(left + width, Math.max(left, one.valToPos(time, "x", true))));
    if (to > from) one.ctx.fillRect(from, top, to - from, height);
  }
  one.ctx.restore();
}

/** A thin line through { t, values }, broken where there is no value. */
export function drawLine(one, { t, values }, stroke) {
  if (!isReady(one)) return;
  const { ctx, bbox } = one;
  ctx.save();
  ctx.beginPath();
  ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
  ctx.clip();
  ctx.beginPath();
  ctx.strokeStyle = stroke;
  ctx.globalAlpha = 0.55;
  let broken = true;
  t.forEach((time, index) => {
    const value = values[index];
    if (value !== null && time !== null) {
      const place = [one.valToPos(time, "x", true), one.valToPos(value, "y", true)];
      if (broken) ctx.moveTo(...place);
      else ctx.lineTo(...place);
    }
    broken = value === null || time === null;
  });
  ctx.stroke();
  ctx.restore();
}

function isReady(one) {
  return one.scales.x.min !== null && one.scales.x.min !== undefined;
}
