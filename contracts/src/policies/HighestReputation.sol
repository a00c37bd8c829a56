// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IMatchingPolicy} from "../interfaces/IMatchingPolicy.sol";
import {IServiceListener} from "../interfaces/IServiceListener.sol";
import {IServiceManager} from "../interfaces/IServiceManager.sol";
import {KindId} from "../types/KindId.sol";
import {Passed} from "../types/Passed.sol";
import {ServiceId} from "../types/ServiceId.sol";
import {TaskId} from "../types/TaskId.sol";

/// @title The service with the best reputation. Among equals the cheapest, then the one that has waited longest.
contract HighestReputation is IMatchingPolicy {
    /// @inheritdoc IMatchingPolicy
    function serviceFor(IServiceManager services, KindId kindId, uint256 reward, Passed passed)
        external
        view
        returns (ServiceId)
    {
        return services.mostReputableIdle(kindId, reward, passed);
    }

    /// @inheritdoc IMatchingPolicy
    function taskFor(
        IServiceListener tasks,
        IServiceManager,
        KindId kindId,
        ServiceId serviceId,
        uint256 price
    ) external view returns (TaskId) {
        return tasks.oldestOpen(serviceId, kindId, price);
    }
}
