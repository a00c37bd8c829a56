#!/bin/sh
# Post a cleaning with curl and wait until it is over: RODEO_TOKEN=... post_and_wait.sh URL ITEM REQUEST_ID
set -eu
url=$1 item=$2 request_id=$3
curl="curl --silent --show-error --fail-with-body --oauth2-bearer $RODEO_TOKEN"

answer=$($curl --json "{\"request_id\": \"$request_id\", \"kind\": \"waste_disposal\", \"reward_iec\": \"100\",
                        \"params\": {\"item_id\": \"$item\"}}" "$url/api/actions/post-task") || { echo "$answer"; exit 1; }
task=$(echo "$answer" | grep -o '"task_id": *[0-9]*' | grep -o '[0-9]*')
echo "task $task is posted"

# All events of the task, from the first one on: none is missed. A stream that ended is read again.
folder=$(mktemp -d)
mkfifo "$folder/events"
until
    $curl --no-buffer "$url/api/events?task_id=$task&name=TaskSettled,TaskFailed,TaskCancelled&after=0" >"$folder/events" &
    grep --max-count=1 '^event: ' "$folder/events"
do sleep 1; done
kill $! 2>/dev/null || true
rm -r "$folder"
settled=$($curl "$url/api/tasks/$task")
echo "$settled"
echo "$settled" | grep --quiet '"verdict": *"accepted"'
