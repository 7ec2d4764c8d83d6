// Parts of the page without a server: other devices, the simulator's studies, and a link that restores the page.
import { BOARD, link } from "./connect.js";
import { address, read } from "./address.js";
import { Restored, told } from "./settings.js";
import { Studies } from "./studies.js";

const NAMES = ["nucleo-f446re", "discovery-f407", "paper-1um", "paper-2um", "epfl-paddle", "rice-paddle", "hapkit", "smartknob"];
const LIMIT = 1 << 20; // bytes; the limit of `cargo sim` for a scene file

const by = (id) => document.getElementById(id);
const make = (name, more = {}, ...inside) => {
  const item = Object.assign(document.createElement(name), more);
  item.append(...inside);
  return item;
};

const style = make("link", { rel: "stylesheet", href: new URL("web.css", import.meta.url) });
document.head.append(style);
if (window !== window.top) document.documentElement.classList.add("embedded");

// The device.
const names = make("select", { id: "scene" }, ...NAMES.map((name) => new Option(name)));
const file = make("input", { type: "file", id: "file", accept: ".toml", hidden: true });
const open = make("button", { id: "open", title: "a scene file; it stays in this browser" }, "File …");
const share = make("button", { id: "share", title: "restores device and settings; a file's text is in it" }, "Copy link");
const runs = make("select", { id: "runs", title: "the release ELF on an emulated chip, or the same library in the simulator's loop" },
  new Option("release ELF", "elf"), new Option("core, no chip", "core"));
const quick = make("button", { id: "quick" }, "Core, real time");
const slowly = make("span");
const slow = make("p", { id: "slow", hidden: true }, slowly, " ", quick);
const wrong = make("p", { id: "wrong", className: "bad", hidden: true });
wrong.role = "alert";
by("left").prepend(make("fieldset", { id: "device" }, make("legend", {}, "Device"),
  make("label", {}, "scene ", names), make("label", {}, "runs ", runs), make("div", { className: "row" }, open, share, file), wrong, slow));

function say(text) {
  wrong.hidden = !text;
  wrong.textContent = text;
}

const studies = new Studies(link, make);
by("left").append(studies.panel);

const restored = new Restored(link, say);
const files = new Map(); // opened files by their name in the list: a file never replaces a scene of this page
const listed = ({ scene, text }) => text === undefined ? scene : `file ${scene}`;
let takes = 0;

// Starts another device, with settings that it gets when it runs. After an error, the message is shown and the previous
// device stays. If the ELF cannot run the device, the core is tried. If the core cannot either, only the simulator's
// studies use the device. Of two overlapping calls the later one counts. Returns whether this call counted.
async function take({ core = false, ...device }, settings = null) {
  const problems = [], number = ++takes;
  const isWanted = () => number === takes;
  const tried = (what) => what.then(() => true, (error) => { problems.push(error.message); return false; });
  say("");
  const known = await tried(link.pool.ask({ ask: "scene", ...device }, "scene"));
  const start = (...what) => isWanted() && tried(link.start(...what, isWanted));
  const runs = known && (await start(device, core) || !core && await start(device, true));
  if (runs) restored.want(settings);
  if (!link.scene) await start({ scene: BOARD }, false);
  if (!isWanted()) return false;
  if (!link.scene) return say(problems.join(" "));
  const name = listed(link.scene);
  if (![...names.options].some(({ value }) => value === name)) names.add(new Option(name));
  if (link.scene.text !== undefined) files.set(name, link.scene);
  names.value = name;
  by("runs").value = link.core ? "core" : "elf";
  slow.hidden = true;
  studies.take(known && !runs ? device : link.scene);
  if (problems.length) say(known && !runs ? `${problems.at(-1)}. The simulator's studies are of ${device.scene} now, the board is not.` :
    runs ? `${problems[0]}. It runs without a chip.` : problems[0]);
  return true;
}

async function takeFile(given) {
  if (!given) return;
  if (given.size > LIMIT) return say(`${given.name} is larger than a scene may be, allowed 1 MiB`);
  let bytes, text;
  try {
    bytes = await given.arrayBuffer();
  } catch (error) {
    return say(`${given.name} cannot be read: ${error.message}`);
  }
  try {
    text = new TextDecoder("utf-8", { fatal: true }).decode(bytes);
  } catch {
    return say(`${given.name} is not UTF-8 text`);
  }
  return take({ scene: given.name, text, core: runs.value === "core" });
}

names.onchange = () => take({ ...files.get(names.value) ?? { scene: names.value }, core: runs.value === "core" });
runs.onchange = () => take({ ...link.scene, core: runs.value === "core" }, held());
quick.onclick = () => take({ ...link.scene, core: true }, held());

// The settings in force, for the next board.
function held() {
  const text = window.zwidth.state?.settings;
  return restored.wanted ?? (text ? told(text) : {});
}
open.onclick = () => file.click();
file.onchange = () => { takeFile(file.files[0]); file.value = ""; };
window.addEventListener("dragover", (event) => { event.preventDefault(); document.body.classList.add("over"); });
window.addEventListener("dragleave", () => document.body.classList.remove("over"));
window.addEventListener("drop", (event) => {
  event.preventDefault();
  document.body.classList.remove("over");
  takeFile(event.dataTransfer.files[0]);
});

share.onclick = async () => {
  const text = await address(link.scene, link.core, held());
  history.replaceState(null, "", text);
  try {
    await navigator.clipboard.writeText(location.href);
    share.textContent = "Copied";
  } catch {
    share.textContent = "In the address bar";
  }
  setTimeout(() => { share.textContent = "Copy link"; }, 2000);
};
async function restore() {
  try {
    const { scene, settings } = await read(location.hash);
    await take(scene, settings);
  } catch (error) {
    if (await take({ scene: BOARD })) say(`the link: ${error.message}`);
  }
}
window.addEventListener("hashchange", restore);

// Speed of the board, and whether the page is visible.
link.on("speed", (speed) => {
  slow.hidden = speed > .95;
  slowly.textContent = `This tab is slower than real time: ${speed.toFixed(2)} virtual seconds a second.`;
  quick.hidden = link.core;
  slow.dataset.speed = speed;
});
let [visible, inView] = [true, true];
const look = () => link.hide(!visible || !inView);
document.addEventListener("visibilitychange", () => { visible = document.visibilityState === "visible"; look(); });
new IntersectionObserver(([{ isIntersecting }]) => { inView = isIntersecting; look(); }).observe(document.body);

// From the second visit on the page works without a network. Registered after the first picture, so as not to delay it.
link.on("curves", function register() {
  if (register.done) return;
  register.done = true;
  performance.mark("first picture");
  navigator.serviceWorker?.register(new URL("../sw.js", import.meta.url)).catch(() => {}); // fails on a plain http host
});

window.zwidth.web = { take, takeFile, studies, link, pool: link.pool };
restore();
