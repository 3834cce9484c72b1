// A model made from the one that is looked at: asked for, waited for, and gone to.

import { ahead, post } from "./api.js";
import { put } from "./dom.js";
import { computed, progressBar } from "./jobs.js";
import { go } from "./location.js";

const UNDER_WAY = { extend: "Adding", remove: "Removing" };

/** Have a model with effects more ("extend") or fewer ("remove") made, and go to it; `said` shows how far it is. */
export async function nextRung(model, change, effects, said, signal) {
  const made = await post(`/identifications/${model.id}/${change}`, { effects }, { signal });
  const bar = progressBar(made.job_id, UNDER_WAY[change]);
  put(said, bar.element);
  const update = (seen) => {
    bar.update(seen);
    if (seen.state === "succeeded") ahead(`/identifications/${made.id}/lineage`);
  };
  const found = await computed("/identifications", made, update, signal).finally(() => put(said));
  // It is of the same robot and the same measurements.
  const known = [["identifications", found], ["robots", model.robot], ...model.measurements.map((one) => ["measurements", one])];
  for (const [kind, one] of known) ahead(`/${kind}/${one.id}`, Promise.resolve(one));
  go({ identification: made.id, tab: "missing", joint: model.joint, measurement: model.measurement }, { arrived: true });
}
