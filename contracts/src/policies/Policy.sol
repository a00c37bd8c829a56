// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IMatchingPolicy} from "../interfaces/IMatchingPolicy.sol";
import {Choice, IServiceManager} from "../interfaces/IServiceManager.sol";
import {ITaskQueues} from "../interfaces/ITaskQueues.sol";
import {KindId} from "../types/KindId.sol";
import {Passed} from "../types/Passed.sol";
import {ServiceId} from "../types/ServiceId.sol";
import {TaskId} from "../types/TaskId.sol";

/// @title A policy that compares services in one of the ways that ServiceManager knows, and gives each the oldest task.
abstract contract Policy is IMatchingPolicy {
    /// @inheritdoc IMatchingPolicy
    function serviceFor(IServiceManager services, KindId kindId, uint256 reward, Passed passed)
        external
        view
        returns (ServiceId)
    {
        return services.bestIdle(kindId, reward, passed, _choice());
    }

    /// @inheritdoc IMatchingPolicy
    function taskFor(ITaskQueues queues, IServiceManager, KindId kindId, ServiceId serviceId, uint256 price)
        external
        view
        returns (TaskId)
    {
        return queues.oldestOpen(serviceId, kindId, price);
    }

    function _choice() internal pure virtual returns (Choice);
}
