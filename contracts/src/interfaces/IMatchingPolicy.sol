// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {KindId} from "../types/KindId.sol";
import {Passed} from "../types/Passed.sol";
import {ServiceId} from "../types/ServiceId.sol";
import {TaskId} from "../types/TaskId.sol";
import {IServiceManager} from "./IServiceManager.sol";
import {ITaskQueues} from "./ITaskQueues.sol";

/// @title Chooses the idle service that gets a task, and the waiting task that a service gets.
/// @notice A policy only chooses: a service is paid its own price. It holds no queue and no token, so an organization can
/// replace it in one transaction without moving a task. A task that names a service or a provider needs no policy. A policy that reverts, uses
/// more than 500,000 gas, or chooses what does not fit delays matching, and nothing else (ITaskManager.PolicyFailed).
interface IMatchingPolicy {
    /// @notice The idle service that gets a task of this kind that pays `reward`.
    /// @param services the contract that holds the queue of idle services
    /// @param kindId the number of what is to be done; a kind has another number with each judge
    /// @param reward the most the service may cost, in the token's smallest unit
    /// @param passed the providers that had the task and did not do it: none of them gets it again
    /// @return serviceId 0 if no idle service of that kind costs at most `reward`
    function serviceFor(IServiceManager services, KindId kindId, uint256 reward, Passed passed)
        external
        view
        returns (ServiceId serviceId);

    /// @notice The task that a service gets which becomes free while tasks wait that it can do. Asked before one that names
    /// the service or its provider goes first, because it is older than what this returns.
    /// @param queues where tasks wait
    /// @param services the contract that knows the service
    /// @param kindId the number of what it does
    /// @param price what it is paid, in the token's smallest unit
    /// @return taskId an open task of this kind that names nobody, has not passed the service's provider, and whose reward is at
    /// least `price`
    function taskFor(
        ITaskQueues queues,
        IServiceManager services,
        KindId kindId,
        ServiceId serviceId,
        uint256 price
    ) external view returns (TaskId taskId);
}
