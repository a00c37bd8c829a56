"""Post a cleaning over plain Zenoh and wait until it is over, without a line of RODEO:
python post_and_wait_zenoh.py ENDPOINT ORG ITEM REQUEST_ID

ENDPOINT is the router's: unixsock-stream/<data_dir>/bus/router.sock on the site's own machine."""

import json
import sys
import threading

import zenoh

ENDS = {"settled", "failed", "cancelled"}


def ask(session: zenoh.Session, key: str, request: dict | None = None) -> dict:
    body = None if request is None else json.dumps(request)
    for reply in session.get(key, payload=body, timeout=30.0):
        if reply.ok is None:
            raise SystemExit(f"refused: {reply.err.payload.to_string()}")
        return json.loads(reply.ok.payload.to_string())
    raise SystemExit(f"nobody answers {key}: is the bridge running?")


def main(endpoint: str, org: str, item: str, request_id: str) -> int:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    happened = threading.Event()
    with zenoh.open(config) as session:
        listener = session.declare_subscriber(f"rodeo/{org}/event/*", lambda _sample: happened.set())
        request = {"request_id": request_id, "kind": "waste_disposal", "reward_iec": "100"}
        request["params"] = {"item_id": item}
        task_id = ask(session, f"rodeo/{org}/wallet/organization/register_task", request)["task_id"]
        print(f"task {task_id} is posted")
        while (task := ask(session, f"rodeo/{org}/state/task/{task_id}"))["state"] not in ENDS:
            happened.wait(timeout=2.0)  # an event may be lost: look all the same
            happened.clear()
        listener.undeclare()
    print(f"{task['state']}: {task['executor_name']} was paid {task['paid_iec']} IEC")
    print(f"{task['verdict']}: {task['reason']}")
    return 0 if task["verdict"] == "accepted" else 1


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:5]))
