// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {KindId} from "../types/KindId.sol";
import {Passed} from "../types/Passed.sol";
import {ServiceId} from "../types/ServiceId.sol";
import {TaskId} from "../types/TaskId.sol";
import {Weight} from "../types/Weight.sol";
import {IMatchingPolicy} from "./IMatchingPolicy.sol";
import {IServiceManager} from "./IServiceManager.sol";

/// @title Open tasks in the order in which they were posted, the providers that each of them has passed, and what became of
/// tasks that named somebody.
/// @notice A kind has a queue of the tasks that name nobody, and another one of those that only proven providers are offered.
/// Each service and each provider has a queue of the tasks that name it. The task manager makes this contract and is the
/// only one that changes anything here.
interface ITaskQueues {
    /// @notice The provider had the task and did not do it. This attempt does not count.
    /// @param gaveUp it submitted a proof that it could not do the work
    event TaskPassed(TaskId indexed taskId, uint32 indexed provider, bool gaveUp);

    error NotTaskManager(address caller);
    /// @notice The policy may need so much, and the caller left less: it would have failed for that alone.
    error TooLittleGas(uint256 needed);

    /// @notice Let a task wait in a queue. Only the task manager.
    /// @param queue its number: the kind's, see types/KindId.sol, or of a service or provider
    /// @param taskId the task
    /// @param weight by which it is found
    function put(uint256 queue, TaskId taskId, Weight weight) external;

    /// @notice Take a task out of its queue. Only the task manager.
    /// @param queue its number
    /// @param taskId the task
    function remove(uint256 queue, TaskId taskId) external;

    /// @notice Put a provider on a task's list. Only the task manager.
    /// @param taskId the task
    /// @param provider its number, see IServiceManager.numberOf
    /// @param gaveUp it submitted a proof that it could not do the work
    /// @return list as it is then
    function pass(TaskId taskId, uint32 provider, bool gaveUp) external returns (Passed list);

    /// @notice A creator posts a task that names a service or a provider. Only the task manager.
    /// @param creator who
    /// @return voids how many of 100 such tasks of the creator have ended void; 0 for fewer than MIN_NAMED
    function countNamed(address creator) external returns (uint256 voids);

    /// @notice A task that named somebody has ended void. Only the task manager.
    /// @param creator who posted it
    function countVoid(address creator) external;

    /// @notice Returns the providers that a task has passed.
    /// @param taskId the task
    function passed(TaskId taskId) external view returns (Passed);

    /// @notice Returns the oldest task of a queue that pays enough and has not passed this provider, among the first
    /// MAX_LOOKS that pay enough.
    /// @param queue its number
    /// @param level the least weight that pays enough
    /// @param provider its number; 0 for any
    /// @return taskId 0 if there is none
    function oldest(uint256 queue, uint64 level, uint32 provider) external view returns (TaskId taskId);

    /// @notice Returns the oldest task of a kind that names nobody, pays enough, and may be offered to this provider.
    /// @param kindId the kind
    /// @param level the level of the least reward that pays enough, see Units
    /// @param provider its number; 0 for any
    /// @param proven whether tasks for proven providers are among them
    /// @return taskId 0 if there is none
    function oldestOf(KindId kindId, uint64 level, uint32 provider, bool proven)
        external
        view
        returns (TaskId taskId);

    /// @notice Returns the service that a policy chooses for a task; one that there is not if the policy fails. Reverts with
    /// TooLittleGas.
    /// @param policy which
    /// @param services among which it chooses
    /// @param kindId the task's kind
    /// @param reward the most that the service may cost, in the token's smallest unit
    /// @param list the providers that the task has passed
    /// @return serviceId 0 if none waits
    function serviceFor(
        IMatchingPolicy policy,
        IServiceManager services,
        KindId kindId,
        uint256 reward,
        Passed list
    ) external view returns (ServiceId serviceId);

    /// @notice Returns the task that a policy chooses for a service; one that there is not if the policy fails. Reverts with
    /// TooLittleGas.
    /// @param policy which
    /// @param services where the service is
    /// @param kindId what the service does
    /// @param serviceId the service
    /// @param price what it costs, in the token's smallest unit
    function taskFor(
        IMatchingPolicy policy,
        IServiceManager services,
        KindId kindId,
        ServiceId serviceId,
        uint256 price
    ) external view returns (TaskId taskId);
}
