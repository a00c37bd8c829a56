// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

/// @notice Why a key was revoked. None while it is not: nobody revokes without saying why.
/// Superseded: another key took over, and what this one signed before stays good. Compromised: somebody else may
/// have signed with it, also before.
enum Revocation {
    None,
    Superseded,
    Compromised
}

/// @param role what the device is, ASCII: robot, bin, meter, mocap
/// @param name which one it is on its site, ASCII: panther1, itrash, dock1
/// @param owner the participant it works for
/// @param registrar who registered it
/// @param registeredAt block time, s
/// @param revokedAt block time, s; 0 while its signatures count
/// @param revocation why it was revoked
struct Device {
    bytes32 role;
    bytes32 name;
    address owner;
    uint48 registeredAt;
    uint48 revokedAt;
    address registrar;
    Revocation revocation;
}

/// @title Which keys may sign evidence.
/// @notice A key is registered once and revoked once: what it signed in between stays checkable. Of the keys that
/// are not revoked, one at most has a role and a name: the bin of that name is this key and no other.
interface IDeviceRegistry {
    event DeviceRegistered(
        address indexed device,
        bytes32 indexed role,
        address indexed owner,
        bytes32 deviceName,
        address registrar
    );
    event DeviceRevoked(address indexed device, Revocation reason);
    /// @param root of what the device signed on `day`, counted from 1970-01-01 UTC
    /// @param uri where its log can be fetched
    event WitnessRoot(address indexed device, uint64 indexed day, bytes32 root, string uri);

    error DeviceAlreadyRegistered(address device);
    error UnknownDevice(address device);
    error DeviceAlreadyRevoked(address device, uint256 revokedAt);
    error InvalidDevice(address device, bytes32 role, address owner, bytes32 name);
    /// @param holder the key that has the name in this role; revoke it first
    error DeviceNameTaken(bytes32 role, bytes32 name, address holder);
    error RevocationWithoutReason(address device);
    /// @notice Neither an operator nor the device's owner.
    error NotDeviceOwner(address device, address caller, address owner);
    error RootAlreadyPosted(address device, uint64 day, bytes32 root);
    error InvalidRoot(address device, uint64 day, bytes32 root, uint64 today);

    /// @notice Let `device_` sign as the `role` called `name`, for `owner`. Only the administrator.
    function registerDevice(address device_, bytes32 role, address owner, bytes32 name) external;

    /// @notice From now on the device's signatures do not count; what becomes of earlier ones depends on
    /// `reason`. Only the administrator.
    function revokeDevice(address device_, Revocation reason) external;

    /// @notice Fix what the device signed on a day, today or before: once, for good. Only an operator and the device's
    /// owner.
    function postRoot(address device_, uint64 day, bytes32 root, string calldata uri) external;

    /// @notice The root of what the device signed on `day`; 0 if it is not posted.
    function rootOf(address device_, uint64 day) external view returns (bytes32);

    /// @notice The device's record. Reverts with UnknownDevice.
    function device(address device_) external view returns (Device memory);

    /// @notice The key that has `name` in `role` now; 0 if none has.
    function deviceNamed(bytes32 role, bytes32 name) external view returns (address);
}
