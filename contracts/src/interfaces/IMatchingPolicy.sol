// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {ServiceId} from "../types/ServiceId.sol";
import {IServiceManager} from "./IServiceManager.sol";

/// @title Chooses the idle service that gets a task, and what it is paid.
/// @notice A policy only chooses. It holds no queue and no token, so an organization can replace it in one
/// transaction without moving a task. Tasks are always served in order of registration.
interface IMatchingPolicy {
    /// @notice The idle service that gets a task of `kind` that pays `reward`. A task that names a service, and a
    /// service that becomes free while tasks wait, need no policy.
    /// @param services the contract that holds the queue of idle services
    /// @param kind what is to be done, ASCII
    /// @param reward the most the service may cost, in the token's smallest unit
    /// @return serviceId 0 if no idle service of that kind costs at most `reward`
    /// @return price what it is paid, at most `reward`; never less than the service's own price, which 0 stands for
    function serviceFor(IServiceManager services, bytes32 kind, uint256 reward)
        external
        view
        returns (ServiceId serviceId, uint256 price);
}
