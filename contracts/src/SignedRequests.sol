// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Address} from "@openzeppelin/contracts/utils/Address.sol";
import {EIP712} from "@openzeppelin/contracts/utils/cryptography/EIP712.sol";
import {ECDSA} from "@openzeppelin/contracts/utils/cryptography/ECDSA.sol";
import {SignatureChecker} from "@openzeppelin/contracts/utils/cryptography/SignatureChecker.sol";
import {BitMaps} from "@openzeppelin/contracts/utils/structs/BitMaps.sol";
import {IDisputeJudge} from "./interfaces/IDisputeJudge.sol";
import {ChallengeRequest, ISignedRequests} from "./interfaces/ISignedRequests.sol";
import {ITaskManager, TaskRequest} from "./interfaces/ITaskManager.sol";
import {TaskId} from "./types/TaskId.sol";

/// @dev The only contract from which TaskManager and DisputeJudge take the caller's address from the end of the calldata
/// (ERC-2771). It calls no functions but the six here: one that calls others by delegatecall would let a signer append
/// somebody else's address. Whatever contract a signer names as the judge is called with `challenge` alone.
contract SignedRequests is ISignedRequests, EIP712 {
    using BitMaps for BitMaps.BitMap;

    bytes private constant TASK_TYPE =
        "TaskRequest(bytes32 kind,uint256 reward,uint32 executionWindow,uint32 verdictWindow,uint8 maxAttempts,bytes32 rules,uint32 serviceId,address provider,string params)";
    bytes32 private constant TASK_TYPEHASH = keccak256(TASK_TYPE);
    bytes32 private constant REGISTER_TYPEHASH = keccak256(
        bytes.concat(
            "RegisterTask(address creator,TaskRequest request,uint256 nonce,uint256 deadline)", TASK_TYPE
        )
    );
    bytes32 private constant CANCEL_TYPEHASH =
        keccak256("CancelTask(address creator,uint256 taskId,uint256 nonce,uint256 deadline)");
    bytes32 private constant PROOF_TYPEHASH = keccak256(
        "SubmitProof(address executor,uint256 taskId,uint8 attempt,bytes32 proofHash,string uri,uint256 nonce,uint256 deadline)"
    );
    bytes32 private constant ACCEPT_TYPEHASH =
        keccak256("AcceptTask(address executor,uint256 taskId,uint8 attempt,uint256 nonce,uint256 deadline)");
    bytes32 private constant ABANDON_TYPEHASH = keccak256(
        "AbandonTask(address executor,uint256 taskId,uint8 attempt,uint256 nonce,uint256 deadline)"
    );

    bytes32 private constant CHALLENGE_TYPEHASH = keccak256(
        "Challenge(address challenger,address judge,uint256 taskId,uint8 attempt,uint8 instance,string reason,uint256 nonce,uint256 deadline)"
    );

    ITaskManager public immutable tasks;

    mapping(address signer => BitMaps.BitMap) private _used;

    /// @dev TaskManager makes this contract, so that neither of the two can be wired to another one.
    constructor() EIP712("RODEO SignedRequests", "1") {
        tasks = ITaskManager(msg.sender);
    }

    /// @inheritdoc ISignedRequests
    function registerTaskFor(
        address creator,
        TaskRequest calldata request,
        uint256 nonce,
        uint256 deadline,
        bytes calldata signature
    ) external returns (TaskId taskId) {
        // The signer is in what it signs, because the same key may sign for several contracts.
        bytes32 said = keccak256(abi.encode(REGISTER_TYPEHASH, creator, _hashTask(request), nonce, deadline));
        _requireSigned(creator, said, nonce, deadline, signature);
        _used[creator].set(nonce);
        bytes memory answer =
            _callAs(creator, address(tasks), abi.encodeCall(ITaskManager.registerTask, (request)));
        taskId = abi.decode(answer, (TaskId));
        emit RequestUsed(creator, nonce, taskId, msg.sender);
    }

    /// @inheritdoc ISignedRequests
    function cancelTaskFor(
        address creator,
        TaskId taskId,
        uint256 nonce,
        uint256 deadline,
        bytes calldata signature
    ) external {
        bytes32 said = keccak256(abi.encode(CANCEL_TYPEHASH, creator, taskId, nonce, deadline));
        _requireSigned(creator, said, nonce, deadline, signature);
        _callAs(creator, address(tasks), abi.encodeCall(ITaskManager.cancelTask, (taskId)));
    }

    /// @inheritdoc ISignedRequests
    function acceptTaskFor(
        address executor,
        TaskId taskId,
        uint8 attempt,
        uint256 nonce,
        uint256 deadline,
        bytes calldata signature
    ) external {
        bytes32 said = keccak256(abi.encode(ACCEPT_TYPEHASH, executor, taskId, attempt, nonce, deadline));
        _requireSigned(executor, said, nonce, deadline, signature);
        _used[executor].set(nonce);
        _callAs(executor, address(tasks), abi.encodeCall(ITaskManager.acceptTask, (taskId, attempt)));
    }

    /// @inheritdoc ISignedRequests
    function abandonTaskFor(
        address executor,
        TaskId taskId,
        uint8 attempt,
        uint256 nonce,
        uint256 deadline,
        bytes calldata signature
    ) external {
        bytes32 said = keccak256(abi.encode(ABANDON_TYPEHASH, executor, taskId, attempt, nonce, deadline));
        _requireSigned(executor, said, nonce, deadline, signature);
        _used[executor].set(nonce);
        _callAs(executor, address(tasks), abi.encodeCall(ITaskManager.abandonTask, (taskId, attempt)));
    }

    /// @inheritdoc ISignedRequests
    function submitProofFor(
        address executor,
        TaskId taskId,
        uint8 attempt,
        bytes32 proofHash,
        string calldata uri,
        uint256 nonce,
        uint256 deadline,
        bytes calldata signature
    ) external {
        // In two parts: at once they are too many values for the compiler without IR.
        bytes memory task = abi.encode(PROOF_TYPEHASH, executor, taskId, attempt, proofHash);
        bytes32 said = keccak256(bytes.concat(task, abi.encode(keccak256(bytes(uri)), nonce, deadline)));
        _requireSigned(executor, said, nonce, deadline, signature);
        bytes memory call = abi.encodeCall(ITaskManager.submitProof, (taskId, attempt, proofHash, uri));
        _callAs(executor, address(tasks), call);
    }

    /// @inheritdoc ISignedRequests
    function challengeFor(
        address challenger,
        ChallengeRequest calldata request,
        uint256 nonce,
        uint256 deadline,
        bytes calldata signature
    ) external {
        bytes32 said = keccak256(
            abi.encode(
                CHALLENGE_TYPEHASH,
                challenger,
                request.judge,
                request.taskId,
                request.attempt,
                request.instance,
                keccak256(bytes(request.reason)),
                nonce,
                deadline
            )
        );
        _requireSigned(challenger, said, nonce, deadline, signature);
        _used[challenger].set(nonce);
        bytes memory call = abi.encodeCall(
            IDisputeJudge.challenge, (request.taskId, request.attempt, request.instance, request.reason)
        );
        _callAs(challenger, request.judge, call);
    }

    /// @inheritdoc ISignedRequests
    function revokeRequest(uint256 nonce) external {
        _requireUnused(msg.sender, nonce);
        _used[msg.sender].set(nonce);
        emit RequestRevoked(msg.sender, nonce);
    }

    /// @inheritdoc ISignedRequests
    function isNonceUsed(address signer, uint256 nonce) external view returns (bool) {
        return _used[signer].get(nonce);
    }

    /// @dev What fails there fails here, so that no relayer uses up a nonce with a call that fails for too little gas.
    function _callAs(address signer, address target, bytes memory call) private returns (bytes memory) {
        return Address.functionCall(target, bytes.concat(call, bytes20(signer)));
    }

    function _requireUnused(address signer, uint256 nonce) private view {
        if (_used[signer].get(nonce)) revert NonceUsed(signer, nonce);
    }

    /// @dev The signer has not revoked it either.
    function _requireSigned(
        address signer,
        bytes32 said,
        uint256 nonce,
        uint256 deadline,
        bytes calldata signature
    ) private view {
        if (block.timestamp > deadline) revert RequestExpired(deadline, block.timestamp);
        bytes32 digest = _hashTypedDataV4(said);
        if (!_hasSigned(signer, digest, signature)) revert NotSignedBy(signer);
        _requireUnused(signer, nonce);
    }

    /// @dev An account's own key counts although the account has code (EIP-7702); ERC-1271 is asked otherwise.
    function _hasSigned(address signer, bytes32 digest, bytes calldata signature)
        private
        view
        returns (bool)
    {
        // slither-disable-next-line unused-return
        (address recovered, ECDSA.RecoverError failed,) = ECDSA.tryRecoverCalldata(digest, signature);
        if (failed == ECDSA.RecoverError.NoError && recovered == signer) return true;
        return SignatureChecker.isValidERC1271SignatureNowCalldata(signer, digest, signature);
    }

    function _hashTask(TaskRequest calldata request) private pure returns (bytes32) {
        return keccak256(
            abi.encode(
                TASK_TYPEHASH,
                request.kind,
                request.reward,
                request.executionWindow,
                request.verdictWindow,
                request.maxAttempts,
                request.rules,
                request.serviceId,
                request.provider,
                keccak256(bytes(request.params))
            )
        );
    }
}
