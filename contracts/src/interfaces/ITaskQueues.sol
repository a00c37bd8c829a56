// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {KindId} from "../types/KindId.sol";
import {Passed} from "../types/Passed.sol";
import {ServiceId} from "../types/ServiceId.sol";
import {TaskId} from "../types/TaskId.sol";

/// @notice Why an attempt failed. NotAccepted: the executor did not accept it in the grace period. Abandoned: the
/// executor gave it back in the grace period, or had not accepted it. AbandonedLate: the executor had accepted it, and gave it back after the
/// grace period. The others are rulings.
enum Cause {
    Rejected,
    GivenUp,
    Void,
    ExecutionExpired,
    NotAccepted,
    Abandoned,
    AbandonedLate
}

/// @title Which open task meets which service: tasks in the order in which they were posted, the providers that each of them
/// has passed, what the policy says, and what became of tasks that named somebody.
/// @notice A kind has a queue of the tasks that name nobody, and another one of those that only proven providers are offered.
/// Each service and each provider has a queue of the tasks that name it. The task manager makes this contract and is the
/// only one that changes anything here.
interface ITaskQueues {
    /// @notice The provider had the task and did not do it. This attempt does not count.
    /// @param gaveUp it submitted a proof that it could not do the work
    event TaskPassed(TaskId indexed taskId, uint32 indexed provider, bool gaveUp);

    error NotTaskManager(address caller);
    /// @notice A task names a service or a provider, not both.
    error TwoNamed(uint32 serviceId, address provider);
    /// @notice The policy may need so much, and the caller left less: it would have failed for that alone.
    error TooLittleGas(uint256 needed);

    /// @notice Let a task wait in its queue. Only the task manager.
    /// @param named the service that it names, or the address of the provider that it names as a number; 0 for nobody
    /// @param reward what it pays at most, in the token's smallest unit
    /// @param list the providers that it has passed
    function put(TaskId taskId, KindId kindId, uint160 named, uint256 reward, Passed list) external;

    /// @notice Take a task out of its queue. Only the task manager.
    /// @param kindId as for put
    /// @param named as for put
    /// @param tried whether it has had an attempt: before the first it has passed nobody
    /// @return list the providers that it has passed
    function remove(TaskId taskId, KindId kindId, uint160 named, bool tried) external returns (Passed list);

    /// @notice Take the next task of a service that is free out of its queue: of those that name nobody the one that the policy
    /// chooses, or the oldest; but an older one that names the service, or its provider, goes first. Only the task manager.
    /// @param asks whether the policy is asked
    /// @return taskId 0 if there is none
    /// @return list the providers that it has passed
    /// @return failed whether the policy failed, or chose what it may not
    function take(ServiceId serviceId, bool asks) external returns (TaskId taskId, Passed list, bool failed);

    /// @notice An attempt has failed. It does not count if it was given back in the grace period or before it was accepted, if
    /// nobody accepted it in that, or if a proven provider gave it up: its provider is put on the task's list, and a task that
    /// names somebody ends. Only the task manager.
    /// @param serviceId whose attempt it was
    /// @param cause why it failed
    /// @param creator who posted the task
    /// @param named whether it names somebody
    /// @return ends whether the task ends with that, however many attempts are left
    /// @return list the providers that it has passed
    function endAttempt(TaskId taskId, ServiceId serviceId, Cause cause, address creator, bool named)
        external
        returns (bool ends, Passed list);

    /// @notice A creator posts a task that names a service or a provider, which is counted. Reverts unless it may, of a provider
    /// with each service of the kind: see IProviders.requireNamable and IServiceManager.serviceOf. Only the task manager.
    /// @param creator who
    /// @param serviceId the service that it names; 0 if it names a provider
    /// @param provider the provider that it names; 0 if it names a service
    /// @param kind what is to be done, ASCII
    /// @param reward the most that it may cost, in the token's smallest unit
    /// @return named the service, or one of the provider
    function hire(address creator, uint32 serviceId, address provider, bytes32 kind, uint256 reward)
        external
        returns (ServiceId named);

    /// @notice Returns the providers that a task has passed.
    function passed(TaskId taskId) external view returns (Passed);

    /// @notice Returns the oldest open task that pays enough, names nobody, and may be offered to this service, among the first
    /// MAX_LOOKS of a queue that pay enough.
    /// @param serviceId the service; 0 for the oldest of all
    /// @param kindId the number of what is to be done, see IOrganization.numberOf
    /// @param price the least that it pays, in the token's smallest unit
    /// @return taskId 0 if there is none
    function oldestOpen(ServiceId serviceId, KindId kindId, uint256 price)
        external
        view
        returns (TaskId taskId);

    /// @notice Returns the service that the policy chooses for a task; one that there is not if the policy fails. Reverts with
    /// TooLittleGas.
    /// @param kindId the task's kind
    /// @param reward the most that the service may cost, in the token's smallest unit
    /// @param list the providers that the task has passed
    /// @return serviceId 0 if none waits
    function serviceFor(KindId kindId, uint256 reward, Passed list)
        external
        view
        returns (ServiceId serviceId);
}
