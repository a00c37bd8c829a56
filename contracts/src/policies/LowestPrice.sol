// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IMatchingPolicy} from "../interfaces/IMatchingPolicy.sol";
import {IServiceListener} from "../interfaces/IServiceListener.sol";
import {IServiceManager} from "../interfaces/IServiceManager.sol";
import {KindId} from "../types/KindId.sol";
import {Passed} from "../types/Passed.sol";
import {ServiceId} from "../types/ServiceId.sol";
import {TaskId} from "../types/TaskId.sol";

/// @title The cheapest service. Among equals the best reputation, then the one that has waited longest.
/// @notice A service is paid what it asks. So it pays a provider to ask as much as the next cheaper one would lose by.
contract LowestPrice is IMatchingPolicy {
    /// @inheritdoc IMatchingPolicy
    function serviceFor(IServiceManager services, KindId kindId, uint256 reward, Passed passed)
        external
        view
        returns (ServiceId)
    {
        return services.cheapestIdle(kindId, reward, passed);
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
