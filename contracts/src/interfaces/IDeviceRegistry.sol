// SPDX-License-Identifier: MIT
pragma solidity ^0.8.28;

/// @param role what the device is, ASCII: robot, bin, meter, mocap
/// @param owner the participant it works for
/// @param registrar who registered it
/// @param registeredAt block time, s
/// @param revokedAt block time, s; 0 while its signatures count
struct Device {
    bytes32 role;
    address owner;
    uint48 registeredAt;
    uint48 revokedAt;
    address registrar;
}

/// @title Which keys may sign evidence.
/// @notice A key is registered once and revoked once: what it signed in between stays checkable.
interface IDeviceRegistry {
    event DeviceRegistered(
        address indexed device, bytes32 indexed role, address indexed owner, address registrar
    );
    event DeviceRevoked(address indexed device);

    error DeviceAlreadyRegistered(address device);
    error UnknownDevice(address device);
    error DeviceAlreadyRevoked(address device, uint256 revokedAt);
    error InvalidDevice(address device, bytes32 role, address owner);

    /// @notice Let `device_` sign as `role` for `owner`. Only the administrator.
    function registerDevice(address device_, bytes32 role, address owner) external;

    /// @notice From now on the device's signatures do not count. Only the administrator.
    function revokeDevice(address device_) external;

    /// @notice The device's record. Reverts with UnknownDevice.
    function device(address device_) external view returns (Device memory);
}
