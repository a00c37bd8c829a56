// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IERC1271} from "@openzeppelin/contracts/interfaces/IERC1271.sol";
import {IERC20} from "@openzeppelin/contracts/token/ERC20/IERC20.sol";
import {ECDSA} from "@openzeppelin/contracts/utils/cryptography/ECDSA.sol";
import {Vm} from "forge-std/Vm.sol";
import {ChallengeRequest} from "../src/interfaces/ISignedRequests.sol";
import {TaskRequest} from "../src/interfaces/ITaskManager.sol";
import {TaskId} from "../src/types/TaskId.sol";

/// @notice A contract that owns tokens, for which one key signs (ERC-1271).
contract SignerWallet is IERC1271 {
    address private immutable _owner;

    constructor(address owner, IERC20 token, address tasks) {
        _owner = owner;
        token.approve(tasks, type(uint256).max);
    }

    function isValidSignature(bytes32 hash, bytes calldata signature) external view returns (bytes4) {
        (address signer,,) = ECDSA.tryRecoverCalldata(hash, signature);
        return signer == _owner ? IERC1271.isValidSignature.selector : bytes4(0xffffffff);
    }
}

/// @notice Signs requests as SignedRequests reads them; written down a second time, from its documentation.
library Signing {
    Vm private constant VM = Vm(address(uint160(uint256(keccak256("hevm cheat code")))));
    string private constant TASK =
        "TaskRequest(bytes32 kind,uint256 reward,uint32 executionWindow,uint32 verdictWindow,uint8 maxAttempts,bytes32 rules,uint32 serviceId,address provider,string params)";

    function registration(
        uint256 key,
        address requests,
        address creator,
        TaskRequest memory r,
        uint256 nonce,
        uint256 deadline
    ) internal view returns (bytes memory) {
        bytes32 typehash = keccak256(
            abi.encodePacked(
                "RegisterTask(address creator,TaskRequest request,uint256 nonce,uint256 deadline)", TASK
            )
        );
        bytes32 task = keccak256(
            abi.encode(
                keccak256(bytes(TASK)),
                r.kind,
                r.reward,
                r.executionWindow,
                r.verdictWindow,
                r.maxAttempts,
                r.rules,
                r.serviceId,
                r.provider,
                keccak256(bytes(r.params))
            )
        );
        return _sign(key, requests, abi.encode(typehash, creator, task, nonce, deadline));
    }

    function cancellation(
        uint256 key,
        address requests,
        address creator,
        TaskId taskId,
        uint256 nonce,
        uint256 deadline
    ) internal view returns (bytes memory) {
        bytes32 typehash = keccak256(
            "CancelTask(address creator,uint256 taskId,uint256 nonce,uint256 deadline)"
        );
        return _sign(key, requests, abi.encode(typehash, creator, taskId, nonce, deadline));
    }

    /// @param name AcceptTask or AbandonTask
    function attempt(
        string memory name,
        uint256 key,
        address requests,
        address executor,
        TaskId taskId,
        uint8 number,
        uint256 nonce,
        uint256 deadline
    ) internal view returns (bytes memory) {
        bytes32 typehash = keccak256(
            abi.encodePacked(
                name, "(address executor,uint256 taskId,uint8 attempt,uint256 nonce,uint256 deadline)"
            )
        );
        return _sign(key, requests, abi.encode(typehash, executor, taskId, number, nonce, deadline));
    }

    function proof(
        uint256 key,
        address requests,
        address executor,
        TaskId taskId,
        uint8 number,
        bytes32 proofHash,
        string memory uri,
        uint256 nonce,
        uint256 deadline
    ) internal view returns (bytes memory) {
        bytes32 typehash = keccak256(
            "SubmitProof(address executor,uint256 taskId,uint8 attempt,bytes32 proofHash,string uri,uint256 nonce,uint256 deadline)"
        );
        bytes memory first = abi.encode(typehash, executor, taskId, number, proofHash);
        return _sign(key, requests, bytes.concat(first, abi.encode(keccak256(bytes(uri)), nonce, deadline)));
    }

    function challenge(
        uint256 key,
        address requests,
        address challenger,
        ChallengeRequest memory r,
        uint256 nonce,
        uint256 deadline
    ) internal view returns (bytes memory) {
        bytes32 typehash = keccak256(
            "Challenge(address challenger,address judge,uint256 taskId,uint8 attempt,uint8 instance,string reason,uint256 nonce,uint256 deadline)"
        );
        bytes memory ruling = abi.encode(typehash, challenger, r.judge, r.taskId, r.attempt, r.instance);
        bytes memory rest = abi.encode(keccak256(bytes(r.reason)), nonce, deadline);
        return _sign(key, requests, bytes.concat(ruling, rest));
    }

    function _sign(uint256 key, address requests, bytes memory said) private view returns (bytes memory) {
        bytes32 domain = keccak256(
            abi.encode(
                keccak256(
                    "EIP712Domain(string name,string version,uint256 chainId,address verifyingContract)"
                ),
                keccak256("RODEO SignedRequests"),
                keccak256("1"),
                block.chainid,
                requests
            )
        );
        bytes32 digest = keccak256(abi.encodePacked("\x19\x01", domain, keccak256(said)));
        (uint8 v, bytes32 r, bytes32 s) = VM.sign(key, digest);
        return abi.encodePacked(r, s, v);
    }
}
