"use strict";
// Everything from the bin is shown as text, never as markup.

const byId = (id) => document.getElementById(id);

const percent = (share) => `${Math.round(share * 100)} %`;

function showVerdict(attestation) {
  if (attestation === null) return;
  const said = attestation.payload;
  const likely = Object.entries(said.probabilities).sort((one, other) => other[1] - one[1]).slice(0, 2);
  byId("verdict").textContent = said.full
    ? `${said.class}: ${said.compartment} is full`
    : `${said.class} → ${said.compartment}`;
  byId("detail").textContent = likely.map(([name, share]) => `${name} ${percent(share)}`).join(", ");
}

function showDisposal(attestation) {
  if (attestation === null) return;
  const fell = attestation.payload;
  const verdict = fell.correct ? "right" : `expected ${fell.expected_compartment ?? "nothing"}`;
  byId("disposal").textContent = `${fell.weight_n.toFixed(2)} N into ${fell.compartment} (${verdict})`;
}

function showFill(fill) {
  byId("fill").replaceChildren(...Object.entries(fill).map(([name, share]) => {
    const label = document.createElement("label");
    const text = document.createElement("span");
    const bar = document.createElement("progress");
    text.textContent = name;
    bar.value = Math.min(share, 1);
    bar.title = percent(share);
    label.append(text, bar);
    return label;
  }));
}

function showHealth(health) {
  byId("health").textContent = health.detail ?? "";
}

const camera = byId("camera");
camera.addEventListener("load", () => { camera.hidden = false; });
camera.addEventListener("error", () => { camera.hidden = true; });  // no picture yet, or none any more

async function refresh() {
  try {
    const state = await (await fetch("state")).json();
    byId("state").textContent = state.state.replaceAll("_", " ");
    showVerdict(state.classification);
    showDisposal(state.disposal);
    showFill(state.fill);
    showHealth(await (await fetch("readyz")).json());
    camera.src = `image?at=${Date.now()}`;
  } catch (error) {
    byId("state").textContent = `the bin does not answer: ${error.message}`;
    camera.hidden = true;  // what it showed last is not what is there now
  }
  setTimeout(refresh, 1000);
}

byId("try").addEventListener("change", async (event) => {
  const [file] = event.target.files;
  if (!file) return;
  byId("answer").textContent = "looking …";
  try {
    const answer = await fetch("classify", { method: "POST", body: file });
    const said = await answer.json();
    byId("answer").textContent = answer.ok
      ? `${said.class} → ${said.compartment}, ${percent(said.confidence)}, ${said.milliseconds} ms`
      : said.detail;
  } catch (error) {
    byId("answer").textContent = `no answer to ${file.name}: ${error.message}`;
  }
});

refresh();
