"""Values in the examples of commands and messages."""

ADDRESS, OTHER = "0x" + "1f" * 20, "0x" + "2e" * 20
DIGEST, BEFORE = "0x" + "3d" * 32, "0x" + "4c" * 32
SIGNATURE = "0x" + "5b" * 64
PROOF_URI = f"https://store.example/{DIGEST[2:]}.mcap"
REPORT_URI = f"https://store.example/{BEFORE[2:]}.json"
LOG_URI = f"https://store.example/{DIGEST[2:]}.json"
VOTE = {
    "task_id": 7,
    "attempt": 1,
    "proof_sha256": DIGEST,
    "report_sha256": BEFORE,
    "rules_sha256": DIGEST,
    "ruling": "accepted",
    "amount_iec": "100",
    "reason": "accepted",
}
SIGNED = {
    "request": {
        "typed_data": {
            "types": {"EIP712Domain": [], "CancelTask": []},
            "primaryType": "CancelTask",
            "domain": {
                "name": "RODEO SignedRequests",
                "version": "1",
                "chainId": 1337,
                "verifyingContract": ADDRESS,
            },
            "message": {"creator": OTHER, "taskId": "7", "nonce": "5", "deadline": "1795406500"},
        },
        "signature": "0x" + "5b" * 65,
    },
}
SIGN = {"command": "cancel_task", "request": {"task_id": 7}, "valid_s": 3600}
PREPARE = {"command": "cancel_task", "request": {"task_id": 7}}
