// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {ServiceId} from "../types/ServiceId.sol";

/// @title What the service manager asks of whoever gives its services their work: to hear of services that are free, and
/// to hold their bonds.
/// @notice The service manager owns this interface, and the task manager fulfils it. So the task manager knows services,
/// and services do not know tasks.
interface IServiceListener {
    /// @notice Give an available service the next open task that it can do, or let it wait. Only the service
    /// manager.
    function onServiceFree(ServiceId serviceId) external;

    /// @notice A service is registered: remember who does its tasks, and take its bond, for which the provider approved this
    /// contract before. Only the service manager.
    /// @param bond in the token's smallest unit
    function enter(ServiceId serviceId, address provider, uint256 bond) external;

    /// @notice Return a bond. Only the service manager.
    /// @param payout who gets it: the provider's payout address
    /// @param amount in the token's smallest unit
    function returnBond(address payout, uint256 amount) external;

    /// @notice Returns how many tasks were ever registered, which is the last id.
    function taskCount() external view returns (uint256);
}
