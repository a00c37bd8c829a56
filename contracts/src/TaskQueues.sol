// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IMatchingPolicy} from "./interfaces/IMatchingPolicy.sol";
import {IServiceListener} from "./interfaces/IServiceListener.sol";
import {IServiceManager} from "./interfaces/IServiceManager.sol";
import {ITaskQueues} from "./interfaces/ITaskQueues.sol";
import {WeightTree} from "./libraries/WeightTree.sol";
import {KindId, queueOf} from "./types/KindId.sol";
import {Passed} from "./types/Passed.sol";
import {ServiceId} from "./types/ServiceId.sol";
import {NO_TASK, TaskId, unpackTask} from "./types/TaskId.sol";
import {Weight} from "./types/Weight.sol";

/// @dev A contract of its own, because most tasks wait in no queue and have passed nobody: they never come here.
/// The mapping `passed` implements the function of that name, which Slither does not see through TaskId.
// slither-disable-next-line unimplemented-functions
contract TaskQueues is ITaskQueues {
    using WeightTree for WeightTree.Tree;

    /// @notice Tasks at which a service that became free looks in a queue.
    uint256 public constant MAX_LOOKS = 4;
    /// @notice Tasks that name somebody, after which a creator has a share of voids.
    uint256 public constant MIN_NAMED = 4;

    /// @dev A creator's tasks that named somebody: both numbers are halved from time to time, so that later ones count more.
    struct Namings {
        uint128 tasks;
        uint128 voids;
    }

    /// @dev Tasks that are counted before both numbers are halved.
    uint256 private constant MAX_NAMED = 64;
    /// @dev The gas of a policy; the caller's transaction outlives one that needs more.
    uint256 private constant POLICY_GAS = 500_000;
    /// @dev No service and no task has this number.
    uint256 private constant NOTHING = type(uint256).max;

    address private immutable _tasks = msg.sender;

    /// @dev Ids grow with time, so the key of an open task is its id: a requeued one is back in its old place.
    mapping(uint256 queue => WeightTree.Tree) private _open;
    /// @inheritdoc ITaskQueues
    mapping(TaskId taskId => Passed) public passed;
    mapping(address creator => Namings) private _namings;

    modifier onlyTaskManager() {
        if (msg.sender != _tasks) revert NotTaskManager(msg.sender);
        _;
    }

    /// @inheritdoc ITaskQueues
    function put(uint256 queue, TaskId taskId, Weight weight) external onlyTaskManager {
        _open[queue].put(taskId.pack(), weight);
    }

    /// @inheritdoc ITaskQueues
    function remove(uint256 queue, TaskId taskId) external onlyTaskManager {
        _open[queue].remove(taskId.pack());
    }

    /// @inheritdoc ITaskQueues
    function pass(TaskId taskId, uint32 provider, bool gaveUp)
        external
        onlyTaskManager
        returns (Passed list)
    {
        list = passed[taskId].add(provider, gaveUp);
        passed[taskId] = list;
        emit TaskPassed(taskId, provider, gaveUp);
    }

    /// @inheritdoc ITaskQueues
    function countNamed(address creator) external onlyTaskManager returns (uint256 voids) {
        Namings memory n = _namings[creator];
        if (n.tasks >= MIN_NAMED) voids = uint256(n.voids) * 100 / n.tasks;
        if (n.tasks == MAX_NAMED) (n.tasks, n.voids) = (n.tasks / 2, n.voids / 2);
        ++n.tasks;
        _namings[creator] = n;
    }

    /// @inheritdoc ITaskQueues
    function countVoid(address creator) external onlyTaskManager {
        ++_namings[creator].voids;
    }

    /// @inheritdoc ITaskQueues
    function oldest(uint256 queue, uint64 level, uint32 provider) external view returns (TaskId) {
        return _oldest(queue, level, provider);
    }

    /// @inheritdoc ITaskQueues
    function oldestOf(KindId kindId, uint64 level, uint32 provider, bool proven)
        external
        view
        returns (TaskId taskId)
    {
        taskId = _oldest(queueOf(kindId, false), level, provider);
        if (!proven) return taskId;
        TaskId other = _oldest(queueOf(kindId, true), level, provider);
        return taskId == NO_TASK || (other != NO_TASK && other < taskId) ? other : taskId;
    }

    /// @inheritdoc ITaskQueues
    function serviceFor(
        IMatchingPolicy policy,
        IServiceManager services,
        KindId kindId,
        uint256 reward,
        Passed list
    ) external view returns (ServiceId) {
        bytes memory question = abi.encodeCall(IMatchingPolicy.serviceFor, (services, kindId, reward, list));
        return ServiceId.wrap(_ask(address(policy), question));
    }

    /// @inheritdoc ITaskQueues
    function taskFor(
        IMatchingPolicy policy,
        IServiceManager services,
        KindId kindId,
        ServiceId serviceId,
        uint256 price
    ) external view returns (TaskId) {
        IServiceListener tasks = IServiceListener(_tasks);
        bytes memory question =
            abi.encodeCall(IMatchingPolicy.taskFor, (tasks, services, kindId, serviceId, price));
        return TaskId.wrap(_ask(address(policy), question));
    }

    /// @dev The policy's choice. A policy that fails has chosen NOTHING, so that it holds up no work and no money. It
    /// does not fail for want of gas: nobody chooses in its place by giving little.
    function _ask(address policy, bytes memory question) private view returns (uint256 chosen) {
        // It gets 63 of 64 parts of what there is, at most.
        bool enough = gasleft() > POLICY_GAS + POLICY_GAS / 32;
        bool success;
        // By hand, because `try` reverts here on a malformed answer, and copies as much as the policy returns.
        assembly ("memory-safe") {
            success := staticcall(POLICY_GAS, policy, add(question, 32), mload(question), 0, 32)
            success := and(success, eq(returndatasize(), 32))
            chosen := mload(0)
        }
        if (success) return chosen;
        if (!enough) revert TooLittleGas(POLICY_GAS);
        return NOTHING;
    }

    function _oldest(uint256 queue, uint64 level, uint32 provider) private view returns (TaskId taskId) {
        uint64 key = 0;
        for (uint256 i = 0; i < MAX_LOOKS; ++i) {
            key = _open[queue].first(level, key + 1);
            taskId = unpackTask(key);
            if (key == 0 || provider == 0 || !passed[taskId].has(provider)) return taskId;
        }
        return NO_TASK;
    }
}
