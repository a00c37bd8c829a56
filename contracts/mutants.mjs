// Plants bugs, one at a time, into a copy of the contracts, and fails unless each of them is found (and nothing in the
// contracts as they are): those of contracts/test/mutants by the invariants, those of contracts/test/unit-mutants by the
// unit tests, and those of contracts/symbolic/mutants by the solver.
//   node contracts/mutants.mjs [NAME...]
// As many bugs are looked for at a time as there are processors.
import { execFile, spawnSync } from "node:child_process";
import { cpSync, mkdtempSync, readdirSync, rmSync, symlinkSync } from "node:fs";
import { availableParallelism, tmpdir } from "node:os";
import { basename, dirname, join } from "node:path";
import { argv } from "node:process";
import { fileURLToPath } from "node:url";
import { symbolic } from "./symbolic.mjs";

const LIMIT_MS = 30 * 60_000;
// Most bugs show in a few runs. Some need terms, a proof and a silent oracle to come together.
const RUNS = [16, 128, 512];

const root = dirname(dirname(fileURLToPath(import.meta.url)));
const wanted = argv.slice(2);

/** A copy of the contracts, in which bugs can be planted. The built ones are not in it: tests of them would fail. */
function copied() {
  const copy = mkdtempSync(join(tmpdir(), "rodeo-mutants-"));
  const folders = ["contracts/src", "contracts/symbolic", "contracts/test"];
  const programs = ["contracts/built.mjs", "contracts/forge.mjs", "contracts/solc.mjs"];
  for (const path of ["foundry.toml", "package.json", ...folders, ...programs]) {
    cpSync(join(root, path), join(copy, path), { recursive: true });
  }
  symlinkSync(join(root, "node_modules"), join(copy, "node_modules"));
  return copy;
}

/** What forge says of some tests of this copy: exit status and output. */
function forge(copy, args, env) {
  const options = { cwd: copy, env: { ...process.env, RODEO_CONTRACTS: "sources", ...env }, timeout: LIMIT_MS, maxBuffer: 1 << 28 };
  return new Promise((resolve, reject) => {
    execFile("node", [join(copy, "contracts", "forge.mjs"), "test", ...args], options, (error, stdout, stderr) => {
      if (error && typeof error.code !== "number") reject(error);
      else resolve({ status: error ? error.code : 0, stdout, stderr });
    });
  });
}

/** Which of these tests fail, and how. Throws when the copy does not compile or run. */
async function failing(copy, args, env) {
  const { status, stdout, stderr } = await forge(copy, args, env);
  if (!/Ran \d+ test suite/.test(stdout)) throw new Error(`forge did not run:\n${stdout}\n${stderr}`);
  const [results] = stdout.split("\nFailing tests:");
  const failed = results.matchAll(/^\[FAIL(?:: (.*?))?\](?:\n\t.*)*\s+(\w+)\(\S*\) \((?:runs|gas)/gm);
  const found = [...failed].map(([, reason, name]) => `${name}: ${reason ?? "no reason"}`);
  if ((status === 0) !== (found.length === 0)) throw new Error(`forge ended with ${status}:\n${stdout.slice(0, 4000)}`);
  return found;
}

/** Which invariants of this copy fail. */
async function broken(copy) {
  for (const runs of RUNS) {
    const found = await failing(copy, ["--fail-fast", "--match-path", "contracts/test/invariant/*"], {
      FOUNDRY_INVARIANT_RUNS: `${runs}`,
      FOUNDRY_INVARIANT_SHRINK_RUN_LIMIT: "0",
    });
    if (found.length > 0) return found;
  }
  return [];
}

/** Which unit tests of this copy fail. They are optimized, because some of them measure gas. */
function unitTests(copy) {
  return failing(copy, ["--no-match-path", "contracts/test/invariant/*"], { FOUNDRY_OPTIMIZER: "true", FOUNDRY_OPTIMIZER_RUNS: "800" });
}

/** What the solver finds in this copy: the names of the checks that do not hold. */
function refuted(copy) {
  const { status, stdout } = symbolic(copy, { encoding: "utf8", timeout: LIMIT_MS, maxBuffer: 1 << 28 });
  // Unless the solver ends, it has found nothing.
  if (/\[TIMEOUT\]/.test(stdout)) throw new Error(`halmos did not come to an end:\n${stdout}`);
  const failed = [...stdout.matchAll(/\[FAIL\]\S* (\w+)\(/g)].map((match) => match[1]);
  if (!/Symbolic test result: (?!0 passed; 0 failed)/.test(stdout)) throw new Error(`halmos did not run:\n${stdout}`);
  if ((status === 0) !== (failed.length === 0)) throw new Error(`halmos ended with ${status}:\n${stdout}`);
  return failed;
}

/** The bugs of this folder that are asked for. */
function asked(patches) {
  const names = readdirSync(join(root, patches)).filter((file) => file.endsWith(".patch"));
  return names.map((file) => basename(file, ".patch")).filter((name) => wanted.length === 0 || wanted.includes(name));
}

/** How many bugs of this folder there are, and which of them `find` missed, looking for so many at a time. */
async function plant(patches, find, abreast) {
  const names = asked(patches);
  if (names.length === 0) return { planted: 0, missed: [] };
  const missed = [];
  const left = [null, ...names]; // null: without a bug nothing may be found.

  async function look(copy, name) {
    if (name !== null) {
      const patch = spawnSync("git", ["apply", join(root, patches, `${name}.patch`)], { cwd: copy, encoding: "utf8" });
      if (patch.status !== 0) throw new Error(`${name} does not apply: ${patch.stderr}`);
    }
    const found = await find(copy);
    if (name === null) {
      if (found.length > 0) throw new Error(`without a planted bug these fail: ${found}`);
      return;
    }
    console.log(found.length > 0 ? `caught  ${name}: ${found.join(", ")}` : `MISSED  ${name}`);
    if (found.length === 0) missed.push(name);
    rmSync(join(copy, "contracts", "src"), { recursive: true });
    cpSync(join(root, "contracts", "src"), join(copy, "contracts", "src"), { recursive: true });
  }

  async function work() {
    const copy = copied();
    try {
      for (let name = left.shift(); name !== undefined; name = left.shift()) await look(copy, name);
    } finally {
      left.length = 0; // After a failure nobody begins with another.
      rmSync(copy, { recursive: true });
    }
  }

  // All of them end, and remove their copies, before the first failure is thrown.
  const ended = await Promise.allSettled(Array.from({ length: Math.min(abreast, left.length) }, work));
  const failed = ended.find(({ status }) => status === "rejected");
  if (failed) throw failed.reason;
  return { planted: names.length, missed };
}

const results = [
  await plant("contracts/test/mutants", broken, availableParallelism()),
  await plant("contracts/test/unit-mutants", unitTests, availableParallelism()),
  await plant("contracts/symbolic/mutants", refuted, 1),
];
const planted = results.reduce((sum, result) => sum + result.planted, 0);
const missed = results.flatMap((result) => result.missed);
console.log(`${planted - missed.length} of ${planted} planted bugs caught`);
process.exitCode = missed.length > 0 || planted === 0 ? 1 : 0;
