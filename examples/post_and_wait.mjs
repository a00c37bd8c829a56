// Post a cleaning over HTTP and wait until it is over: RODEO_TOKEN=... node post_and_wait.mjs URL ITEM REQUEST_ID
const [url, item, requestId] = process.argv.slice(2);
const headers = { Authorization: `Bearer ${process.env.RODEO_TOKEN}` };
const ENDS = ["TaskSettled", "TaskFailed", "TaskCancelled"];

const pause = () => new Promise((resolve) => setTimeout(resolve, 1000));

/** Ask until there is an answer: a console that starts again is waited for. The same request_id posts nothing twice. */
async function api(path, options = {}) {
  for (;; await pause()) {
    let answer;
    try {
      answer = await fetch(`${url}/api${path}`, { ...options, headers: { ...headers, ...options.headers } });
    } catch (error) {
      console.error(`no answer: ${error.message}`);
      continue;
    }
    if (answer.ok) return answer;
    const problem = await answer.json();
    const said = `${problem.code}: ${problem.detail} ${JSON.stringify(problem.details)}`;
    if (answer.status < 500) throw new Error(said); // what we ask is wrong, and stays so
    console.error(said);
  }
}

/** Every event after `last`, also across streams that end: the server ends each after some minutes. */
async function* events(last) {
  for (;; await pause()) {
    const answer = await api("/events", { headers: last ? { "Last-Event-ID": last } : {} });
    let text = "";
    try {
      for await (const chunk of answer.body.pipeThrough(new TextDecoderStream())) {
        text += chunk;
        const blocks = text.split("\n\n");
        text = blocks.pop();
        for (const block of blocks) {
          const field = (name) => block.split("\n").find((line) => line.startsWith(`${name}: `))?.slice(name.length + 2);
          last = field("id") ?? last;
          // The first block has an id and no event: whoever has it misses nothing from here on.
          yield { id: last, event: field("data") ? JSON.parse(field("data")) : null };
        }
      }
    } catch (error) {
      console.error(`the stream broke: ${error.message}`);
    }
  }
}

const stream = events();
await stream.next(); // listen first, then post
const request = { request_id: requestId, kind: "waste_disposal", reward_iec: "100", params: { item_id: item } };
const posted = await api("/actions/post-task", {
  method: "POST", body: JSON.stringify(request), headers: { "Content-Type": "application/json" },
});
const { task_id: taskId } = await posted.json();
console.log(`task ${taskId} is posted`);

// A program that restarts sends the same request again: then the task may be over already.
let task = await (await api(`/tasks/${taskId}`)).json();
while (!["settled", "failed", "cancelled"].includes(task.state)) {
  const { event } = (await stream.next()).value;
  if (event?.task_id === taskId && ENDS.includes(event.name)) task = await (await api(`/tasks/${taskId}`)).json();
}
console.log(`${task.state}: ${task.executor_name} was paid ${task.paid_iec} IEC; verdict ${task.verdict}: ${task.reason}`);
process.exit(task.verdict === "accepted" ? 0 : 1);
