// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Math} from "@openzeppelin/contracts/utils/math/Math.sol";
import {IMatchingPolicy} from "../interfaces/IMatchingPolicy.sol";
import {IServiceListener} from "../interfaces/IServiceListener.sol";
import {IServiceManager} from "../interfaces/IServiceManager.sol";
import {ServiceId} from "../types/ServiceId.sol";
import {TaskId} from "../types/TaskId.sol";

/// @title The cheapest service, paid what the second cheapest costs (Vickrey 1961), at most the reward.
/// @notice What a provider asks decides whether it gets the task, not what it is paid. So it may ask what the work
/// costs it. A service that waits alone has no competitor, and neither has one that becomes free while tasks wait: it gets
/// the oldest that it can do. Such a service is paid the reward.
contract SecondPrice is IMatchingPolicy {
    /// @inheritdoc IMatchingPolicy
    function serviceFor(IServiceManager services, bytes32 kind, uint256 reward)
        external
        view
        returns (ServiceId, uint256)
    {
        return (services.cheapestIdle(kind, reward), Math.min(services.secondPrice(kind), reward));
    }

    /// @inheritdoc IMatchingPolicy
    function taskFor(IServiceListener tasks, IServiceManager, bytes32 kind, ServiceId, uint256 price)
        external
        view
        returns (TaskId, uint256)
    {
        return tasks.oldestOpen(kind, price);
    }
}
