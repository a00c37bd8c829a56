// Plants the bugs of contracts/test/mutants and contracts/symbolic/mutants, one at a time, into a copy of the contracts,
// and fails unless the invariants, or the solver, find each of them (and nothing in the contracts as they are):
//   node contracts/mutants.mjs [NAME...]
import { spawnSync } from "node:child_process";
import { cpSync, mkdtempSync, readFileSync, readdirSync, rmSync, symlinkSync } from "node:fs";
import { tmpdir } from "node:os";
import { basename, dirname, join } from "node:path";
import { argv } from "node:process";
import { fileURLToPath } from "node:url";
import { symbolic } from "./symbolic.mjs";

const LIMIT_MS = 15 * 60_000;

const root = dirname(dirname(fileURLToPath(import.meta.url)));
const wanted = argv.slice(2);
const copy = mkdtempSync(join(tmpdir(), "rodeo-mutants-"));
const source = (path) => cpSync(join(root, path), join(copy, path), { recursive: true });

/** What the invariants find: the names of those that fail. Throws when the copy does not compile or run. */
function broken() {
  const { status, stdout, stderr, error } = spawnSync(
    "node",
    [join(copy, "contracts", "forge.mjs"), "test", "--fail-fast", "--match-path", "contracts/test/invariant/*"],
    {
      cwd: copy,
      // Many runs: some bugs need terms, a proof and a silent oracle to come together.
      env: {
        ...process.env,
        FOUNDRY_OPTIMIZER: "false",
        FOUNDRY_INVARIANT_RUNS: "128",
        FOUNDRY_INVARIANT_SHRINK_RUN_LIMIT: "0",
      },
      encoding: "utf8",
      timeout: LIMIT_MS,
      maxBuffer: 1 << 28,
    },
  );
  if (error) throw error;
  const failed = new Set([...stdout.matchAll(/^(?:\[FAIL.*\])? (\w+)\(\) \(runs/gm)].map((match) => match[1]));
  if (!/Ran \d+ test suite/.test(stdout)) throw new Error(`forge did not run:\n${stdout}\n${stderr}`);
  if ((status === 0) !== (failed.size === 0)) throw new Error(`forge ended with ${status}:\n${stdout.slice(0, 4000)}`);
  return [...failed];
}

/** What the solver finds: the names of the checks that do not hold. */
function refuted() {
  const { status, stdout } = symbolic(copy, { encoding: "utf8", timeout: LIMIT_MS, maxBuffer: 1 << 28 });
  // Unless the solver ends, it has found nothing.
  if (/\[TIMEOUT\]/.test(stdout)) throw new Error(`halmos did not come to an end:\n${stdout}`);
  const failed = [...stdout.matchAll(/\[FAIL\]\S* (\w+)\(/g)].map((match) => match[1]);
  if (!/Symbolic test result: (?!0 passed; 0 failed)/.test(stdout)) throw new Error(`halmos did not run:\n${stdout}`);
  if ((status === 0) !== (failed.length === 0)) throw new Error(`halmos ended with ${status}:\n${stdout}`);
  return failed;
}

/** How many bugs of this folder there are, and which of them `find` missed. */
function plant(patches, find) {
  const names = readdirSync(join(root, patches))
    .filter((file) => file.endsWith(".patch"))
    .map((file) => basename(file, ".patch"))
    .filter((name) => wanted.length === 0 || wanted.includes(name));
  if (names.length === 0) return { planted: 0, missed: [] };
  const found = find();
  if (found.length > 0) throw new Error(`without a planted bug these fail: ${found}`);
  const missed = [];
  for (const name of names) {
    const patch = spawnSync("git", ["apply", join(root, patches, `${name}.patch`)], { cwd: copy, encoding: "utf8" });
    if (patch.status !== 0) throw new Error(`${name} does not apply: ${patch.stderr}`);
    const caught = find();
    console.log(caught.length > 0 ? `caught  ${name}: ${caught.join(", ")}` : `MISSED  ${name}`);
    if (caught.length === 0) missed.push(name);
    rmSync(join(copy, "contracts", "src"), { recursive: true });
    source("contracts/src");
  }
  return { planted: names.length, missed };
}

let results;
try {
  for (const path of ["foundry.toml", "package.json", "contracts/src", "contracts/symbolic"]) source(path);
  const support = ["Fixture.sol", "Committee.sol", "Instances.sol", "PlainToken.sol", "Possession.sol", "Signing.sol"];
  for (const path of [...support, "invariant"]) source(join("contracts", "test", path));
  for (const path of ["contracts/forge.mjs", "contracts/solc.mjs"]) source(path);
  symlinkSync(join(root, "node_modules"), join(copy, "node_modules"));
  results = [plant("contracts/test/mutants", broken), plant("contracts/symbolic/mutants", refuted)];
} finally {
  rmSync(copy, { recursive: true });
}
const planted = results.reduce((sum, result) => sum + result.planted, 0);
const missed = results.flatMap((result) => result.missed);
console.log(`${planted - missed.length} of ${planted} planted bugs caught`);
process.exitCode = missed.length > 0 || planted === 0 ? 1 : 0;
