// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IServiceManager} from "./IServiceManager.sol";

/// @title Which idle service gets a task.
/// @notice A policy only chooses: it holds no queue and no token, so an organization replaces it in one
/// transaction without moving a task. Tasks themselves are always served in order of registration.
interface IMatchingPolicy {
    /// @notice The idle service that shall do a task of `kind` which pays `reward`.
    /// @param services where the idle services wait
    /// @param reward the most the service may cost, in the token's smallest unit
    /// @return serviceId 0 when no idle service of that kind costs at most `reward`
    function serviceFor(IServiceManager services, bytes32 kind, uint256 reward)
        external
        view
        returns (uint256 serviceId);
}
