// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IMatchingPolicy} from "./interfaces/IMatchingPolicy.sol";
import {IOrganization} from "./interfaces/IOrganization.sol";
import {IProviders} from "./interfaces/IProviders.sol";
import {Free, IServiceManager} from "./interfaces/IServiceManager.sol";
import {ITaskManager} from "./interfaces/ITaskManager.sol";
import {Cause, ITaskQueues} from "./interfaces/ITaskQueues.sol";
import {Units} from "./libraries/Units.sol";
import {WeightTree} from "./libraries/WeightTree.sol";
import {KindId, queueOf} from "./types/KindId.sol";
import {Passed} from "./types/Passed.sol";
import {NO_SERVICE, ServiceId, unpackService} from "./types/ServiceId.sol";
import {NO_TASK, TaskId, unpackTask} from "./types/TaskId.sol";
import {weigh} from "./types/Weight.sol";

/// @dev A contract of its own, because most tasks wait in no queue and have passed nobody: they never come here.
/// The mapping `passed` implements the function of that name, which Slither does not see through TaskId.
// slither-disable-next-line unimplemented-functions
contract TaskQueues is ITaskQueues {
    using WeightTree for WeightTree.Tree;

    /// @dev Tasks at which a service that became free looks in a queue.
    uint256 private constant MAX_LOOKS = 4;
    /// @dev Tasks that name somebody, after which a creator has a share of voids.
    uint256 private constant MIN_NAMED = 4;

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
    IOrganization private immutable _organization;
    IServiceManager private immutable _services;
    IProviders private immutable _providers;
    uint256 private immutable _unit;

    /// @dev Ids grow with time, so the key of an open task is its id: a requeued one is back in its old place.
    mapping(uint256 queue => WeightTree.Tree) private _open;
    /// @inheritdoc ITaskQueues
    mapping(TaskId taskId => Passed) public passed;
    mapping(address creator => Namings) private _namings;

    modifier onlyTaskManager() {
        if (msg.sender != _tasks) revert NotTaskManager(msg.sender);
        _;
    }

    constructor(IOrganization organization, IServiceManager services) {
        (_organization, _services, _providers) = (organization, services, services.providers());
        // slither-disable-next-line unused-return
        (_unit,) = Units.unitOf(organization.token());
    }

    /// @inheritdoc ITaskQueues
    function put(TaskId taskId, KindId kindId, uint160 named, uint256 reward, Passed list)
        external
        onlyTaskManager
    {
        // Who names whom it wants may pay its price exactly, which is between two levels.
        uint64 pays = named == 0 ? Units.levelOf(reward, _unit) : Units.wholeOf(reward, _unit);
        _open[queueOf(kindId, named, list.isForProven())].put(taskId.pack(), weigh(pays, 0));
    }

    /// @inheritdoc ITaskQueues
    function remove(TaskId taskId, KindId kindId, uint160 named, bool tried)
        external
        onlyTaskManager
        returns (Passed list)
    {
        if (tried) list = passed[taskId];
        _open[queueOf(kindId, named, list.isForProven())].remove(taskId.pack());
    }

    /// @inheritdoc ITaskQueues
    function take(ServiceId serviceId, bool asks)
        external
        onlyTaskManager
        returns (TaskId taskId, Passed list, bool failed)
    {
        Free memory free = _services.wants(serviceId);
        uint256 queue;
        (taskId, queue) = _oldestOf(free);
        if (taskId != NO_TASK && asks) {
            (TaskId chosen, uint256 itsQueue) = _choose(serviceId, free);
            failed = chosen == NO_TASK;
            if (!failed) (taskId, queue) = (chosen, itsQueue);
        }
        // An older one that names the service, or its provider, goes first, so that no policy lets it wait indefinitely.
        uint160 named = free.named;
        while (named != 0) {
            uint256 itsQueue = queueOf(free.kindId, named, false);
            TaskId first = _oldest(itsQueue, uint64(free.price / _unit), 0);
            if (first != NO_TASK && (taskId == NO_TASK || first < taskId)) {
                (taskId, queue) = (first, itsQueue);
            }
            named = named == serviceId.pack() ? 0 : serviceId.pack();
        }
        if (taskId == NO_TASK) return (NO_TASK, list, false);
        list = passed[taskId];
        _open[queue].remove(taskId.pack());
    }

    /// @inheritdoc ITaskQueues
    function endAttempt(TaskId taskId, ServiceId serviceId, Cause cause, address creator, bool named)
        external
        onlyTaskManager
        returns (bool ends, Passed list)
    {
        list = passed[taskId];
        if (cause == Cause.Void) {
            if (named) ++_namings[creator].voids;
            return (true, list);
        }
        bool gaveUp = cause == Cause.GivenUp;
        if (!gaveUp && cause != Cause.Abandoned && cause != Cause.NotAccepted) return (false, list);
        // slither-disable-next-line unused-return
        (uint32 number, bool proven,) = _services.profile(serviceId);
        if (gaveUp && !proven) return (false, list);
        // A provider that was named and said no would get the task again at once.
        if (named) return (true, list);
        ends = gaveUp && list.someoneGaveUp();
        list = list.add(number, gaveUp);
        passed[taskId] = list;
        emit TaskPassed(taskId, number, gaveUp);
        ends = ends || list.isFull();
    }

    /// @inheritdoc ITaskQueues
    function hire(address creator, uint32 serviceId, address provider, bytes32 kind, uint256 reward)
        external
        onlyTaskManager
        returns (ServiceId named)
    {
        if (serviceId != 0 && provider != address(0)) revert TwoNamed(serviceId, provider);
        uint256 all = serviceId;
        named = unpackService(serviceId);
        if (serviceId == 0) (named, all) = _services.serviceOf(provider, kind, reward);
        Namings memory n = _namings[creator];
        uint256 voids = n.tasks < MIN_NAMED ? 0 : uint256(n.voids) * 100 / n.tasks;
        if (n.tasks == MAX_NAMED) (n.tasks, n.voids) = (n.tasks / 2, n.voids / 2);
        ++n.tasks;
        _namings[creator] = n;
        // Any of them may get the task.
        for (; all != 0; all >>= 32) {
            _providers.requireNamable(unpackService(uint32(all)), creator, voids);
        }
    }

    /// @inheritdoc ITaskQueues
    function oldestOpen(ServiceId serviceId, KindId kindId, uint256 price)
        external
        view
        returns (TaskId taskId)
    {
        (uint32 number, bool isOffered) = (0, true);
        // slither-disable-next-line unused-return
        if (serviceId != NO_SERVICE) (number,, isOffered) = _services.profile(serviceId);
        // slither-disable-next-line unused-return
        (taskId,) = _oldestOf(Free(kindId, price, 0, number, isOffered));
    }

    /// @inheritdoc ITaskQueues
    function serviceFor(KindId kindId, uint256 reward, Passed list) external view returns (ServiceId) {
        return
            ServiceId.wrap(
                _ask(abi.encodeCall(IMatchingPolicy.serviceFor, (_services, kindId, reward, list)))
            );
    }

    /// @dev The policy's choice for this service, and its queue; NO_TASK if that is no open task of the kind that names nobody,
    /// pays less than the price, or may not be offered to the service.
    function _choose(ServiceId serviceId, Free memory free) private view returns (TaskId, uint256 queue) {
        uint256 chosen = _ask(
            abi.encodeCall(IMatchingPolicy.taskFor, (this, _services, free.kindId, serviceId, free.price))
        );
        TaskId taskId = TaskId.wrap(chosen);
        Passed list = passed[taskId];
        queue = queueOf(free.kindId, 0, list.isForProven() && free.proven);
        bool open = _open[queue].first(0, uint64(chosen)) == chosen;
        bool fits = open && !list.has(free.number) && ITaskManager(_tasks).task(taskId).reward >= free.price;
        return fits ? (taskId, queue) : (NO_TASK, queue);
    }

    /// @dev The policy's answer. A policy that fails has chosen NOTHING, so that it holds up no work and no money. It
    /// does not fail for want of gas: nobody chooses in its place by giving little.
    function _ask(bytes memory question) private view returns (uint256 chosen) {
        address policy = address(_organization.policy());
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

    /// @dev The oldest task that names nobody and may be offered to this service, and its queue.
    function _oldestOf(Free memory free) private view returns (TaskId taskId, uint256 queue) {
        uint64 level = Units.levelFor(free.price, _unit);
        queue = queueOf(free.kindId, 0, false);
        taskId = _oldest(queue, level, free.number);
        if (!free.proven) return (taskId, queue);
        uint256 ofProven = queueOf(free.kindId, 0, true);
        TaskId other = _oldest(ofProven, level, free.number);
        if (taskId == NO_TASK || (other != NO_TASK && other < taskId)) return (other, ofProven);
    }

    /// @dev The oldest of a queue that pays enough and has not passed this provider, among the first MAX_LOOKS that pay enough.
    /// @param provider its number; 0 for any
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
