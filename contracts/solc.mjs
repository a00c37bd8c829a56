#!/usr/bin/env node
// npm's solc is a library; forge expects a native compiler. This gives the one the command line of the other.
import { readFileSync } from "node:fs";
import solc from "solc";

const args = process.argv.slice(2);

if (args.includes("--version")) {
  console.log(`solc, the solidity compiler commandline interface\nVersion: ${solc.version()}`);
} else if (args.includes("--standard-json")) {
  process.stdout.write(solc.compile(readFileSync(0, "utf8")));
} else {
  console.error(`solc.mjs: only --version and --standard-json are supported, not: ${args.join(" ")}`);
  process.exitCode = 2;
}
