// A worker of the simulator: one question at a time.
import { Module } from "./module.js";

let module;

onmessage = async ({ data: { compiled, id, question, more = [] } }) => {
  try {
    module ??= await Module.of(compiled);
    const answer = module.ask(question, ...more);
    postMessage({ id, answer }, answer.bytes.map(({ buffer }) => buffer));
  } catch (error) {
    if (error.ended) module = undefined; // after a panic the module's state is not usable
    postMessage({ id, failed: error.message });
  }
};
