// Simulate a virtual robot on a designed motion, and identify its recording.

import { post } from "../api.js";
import { h, part, put } from "../dom.js";
import { awaited } from "../jobs.js";
import { go } from "../page_address.js";
import { pressed, problemBox } from "../problem.js";

/** A button that simulates a design, and a random motion to hold out, and identifies from them. */
export function virtualRobot(design, robot, signal) {
  const said = h("div");
  const button = h("button", { type: "button", id: "simulate-design", disabled: !robot.has_inertias, onclick: () => run() }, "Simulate it and identify");
  const about = robot.has_inertias
    ? "A virtual robot with the inertias of the description, friction and noise runs this motion, and a random motion that is held out."
    : "A virtual robot needs inertias, and this robot's description has none: run the motion on the real one.";

  async function simulated(body, words) {
    const made = await post("/simulations", { robot_id: robot.id, ...body }, { signal });
    return (await awaited("/simulations", made, words, said, signal)).result.measurement_id;
  }

  const run = () => pressed(button, async () => {
    const name = design.name ?? "design";
    const fit = await simulated({ design_id: design.id, role: "identification", name: `${name}, simulated` }, "Simulating the design");
    const held = await simulated({ trajectory: { duration: 10 }, seed: 1, role: "validation", name: "random motion, simulated" }, "Simulating a random motion");
    // Without effects of its own the design was for those that an identification has by itself.
    const effects = design.request.effects ? { effects: design.request.effects } : {};
    const made = await post("/identifications", { robot_id: robot.id, name: `${name}, virtual robot`, measurement_ids: [fit], validation_ids: [held], ...effects });
    dispatchEvent(new Event("models-changed"));
    go({ identification: made.id });
  }, (error) => put(said, problemBox(error)), signal);

  return part("On a virtual robot", h("p", { class: "actions" }, button, h("span", { class: "note" }, about)), said);
}
