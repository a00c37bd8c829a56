// Builds the contracts and writes what running needs, so that running needs no Node:
//   node contracts/build.mjs          write rodeo/chain/artifacts/<Contract>.json, enums.json and origin.json
//   node contracts/build.mjs --check  fail if they differ from the sources
//   node contracts/build.mjs --standard-json [DIR]  write <Contract>.json for explorers, which verify sources by it
import { existsSync, mkdirSync, readdirSync, readFileSync, writeFileSync } from "node:fs";
import { dirname, join, relative } from "node:path";
import { fileURLToPath } from "node:url";
import { current, origin } from "./built.mjs";
import { forge, program } from "./forge.mjs";

const CONTRACTS = [
  "IECoin",
  "Organization",
  "DeviceRegistry",
  "ServiceManager",
  "TaskManager",
  "Providers",
  "TaskQueues",
  "SignedRequests",
  "RoleJudge",
  "CommitteeJudge",
  "DisputeJudge",
  "FirstComeFirstServed",
  "LowestPrice",
  "HighestReputation",
  "MemberVotes",
  "OrganizationTimelock",
  "OrganizationGovernor",
  "BudgetVotes",
  "OrganizationRegistry",
];

const root = dirname(dirname(fileURLToPath(import.meta.url)));
const target = join(root, "rodeo", "chain", "artifacts");

function compiled(name) {
  return JSON.parse(readFileSync(join(root, "contracts", "out", "deploy", `${name}.sol`, `${name}.json`), "utf8"));
}

// The compiler's input, from which it makes the very code that is deployed.
function standardJson(name) {
  const { language, sources, settings } = compiled(name).metadata;
  const { compilationTarget, libraries, ...rest } = settings;
  const outputSelection = { "*": { "*": ["abi", "evm.bytecode.object", "evm.deployedBytecode.object"] } };
  const content = Object.keys(sources).map((path) => [path, { content: readFileSync(join(root, path), "utf8") }]);
  return { language, sources: Object.fromEntries(content), settings: { ...rest, libraries, outputSelection } };
}

function artifact(name) {
  const built = compiled(name);
  const immutables = Object.values(built.deployedBytecode.immutableReferences ?? {}).flat();
  return {
    contractName: name,
    abi: built.abi,
    bytecode: built.bytecode.object,
    deployedBytecode: built.deployedBytecode.object,
    // Where the constructor writes into the deployed code: [start, length] in bytes.
    immutables: immutables.map(({ start, length }) => [start, length]).sort((a, b) => a[0] - b[0]),
  };
}

// The ABI names enums, but does not say what is in them.
function enums() {
  const interfaces = join(root, "contracts", "src", "interfaces");
  const source = readdirSync(interfaces)
    .sort()
    .map((name) => readFileSync(join(interfaces, name), "utf8"))
    .join("\n");
  const found = source.matchAll(/^enum (\w+) \{([^}]*)\}/gm);
  return Object.fromEntries([...found].map(([, name, members]) => [name, members.match(/\w+/g)]));
}

process.env.FOUNDRY_PROFILE = "deploy";
if (forge("build", "--quiet", "contracts/src") !== 0) process.exit(1);

const [task, folder = join(root, "contracts", "out", "standard-json")] = process.argv.slice(2);
if (task === "--standard-json") {
  mkdirSync(folder, { recursive: true });
  for (const name of CONTRACTS) {
    writeFileSync(join(folder, `${name}.json`), JSON.stringify(standardJson(name), null, 1) + "\n");
  }
  console.log(`${CONTRACTS.length} inputs for ${compiled("TaskManager").metadata.compiler.version} are in ${folder}`);
  process.exit();
}

const check = task === "--check";
mkdirSync(target, { recursive: true });

const stale = [];

function update(path, content) {
  const text = JSON.stringify(content, null, 1) + "\n";
  if (existsSync(path) && readFileSync(path, "utf8") === text) return;
  if (check) stale.push(path);
  else writeFileSync(path, text);
}

const built = CONTRACTS.map((name) => [name, artifact(name)]);
const files = new Set(CONTRACTS.flatMap((name) => Object.keys(compiled(name).metadata.sources)));
for (const [name, content] of [...built, ["enums", enums()]]) {
  const path = join(target, `${name}.json`);
  update(path, content);
  files.add(relative(root, path));
}
update(origin(root), current(root, program, [...files].sort()));

if (stale.length > 0) {
  console.error(`built contracts differ from their sources; run \`make contracts\`:\n  ${stale.join("\n  ")}`);
  process.exitCode = 1;
}
