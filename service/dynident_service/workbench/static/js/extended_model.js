// A new model from the one on the page: send the request, wait for its job, open the new model.

import { ahead, post } from "./api.js";
import { awaited } from "./jobs.js";
import { go } from "./page_address.js";

const UNDER_WAY = { extend: "Adding", remove: "Removing" };

/** Have a model with effects more ("extend") or fewer ("remove") made, and go to it; `said` shows how far it is. */
export async function nextRung(model, change, effects, said, signal) {
  const made = await post(`/identifications/${model.id}/${change}`, { effects }, { signal });
  await open(model, made, UNDER_WAY[change], "missing", said, signal);
}

/** Identify again as the model was, with another estimator for all parameters at once, and go to the new model. */
export async function identifyBy(model, estimator, said, signal) {
  const made = await post("/identifications", { ...model.identification.request, strategy: "global", estimator }, { signal });
  await open(model, made, "Identifying", "verdict", said, signal);
}

async function open(model, made, doing, tab, said, signal) {
  const found = await awaited("/identifications", made, doing, said, signal, ({ state }) => {
    if (state === "succeeded") ahead(`/identifications/${made.id}/lineage`);
  });
  // It is of the same robot and the same measurements.
  const known = [["identifications", found], ["robots", model.robot], ...model.measurements.map((one) => ["measurements", one])];
  for (const [kind, one] of known) ahead(`/${kind}/${one.id}`, Promise.resolve(one));
  go({ identification: made.id, tab, joint: model.joint, measurement: model.measurement }, { arrived: true });
}
