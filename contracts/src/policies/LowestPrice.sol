// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IMatchingPolicy} from "../interfaces/IMatchingPolicy.sol";
import {IServiceManager} from "../interfaces/IServiceManager.sol";
import {ServiceId} from "../types/ServiceId.sol";

/// @title The cheapest service. Among equals the best reputation, then the one that has waited longest.
contract LowestPrice is IMatchingPolicy {
    /// @inheritdoc IMatchingPolicy
    function serviceFor(IServiceManager services, bytes32 kind, uint256 reward)
        external
        view
        returns (ServiceId, uint256)
    {
        return (services.cheapestIdle(kind, reward), 0);
    }
}
