// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

/// @notice Why a key was revoked. None: the key is not revoked, because a revocation needs a reason.
/// Superseded: another key took over, and earlier signatures of this key stay valid. Compromised: somebody else may
/// have signed with it, also before the revocation.
enum Revocation {
    None,
    Superseded,
    Compromised
}

/// @param role what the device is, ASCII: robot, bin, meter, mocap
/// @param name unique name of the device in its role on the site, ASCII: panther1, itrash, dock1
/// @param owner the participant that owns the device
/// @param registrar the account that registered it
/// @param registeredAt block time, s
/// @param revokedAt block time, s; 0 while its signatures are valid
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

/// @title The keys that may sign evidence.
/// @notice A key is registered once and revoked once, so signatures from that time stay verifiable. At most one key
/// that is not revoked has a given role and name, so the bin of that name is this key and no other. The organization makes this
/// contract, and registers and revokes here what its administrator decides.
interface IDeviceRegistry {
    event DeviceRegistered(
        address indexed device,
        bytes32 indexed role,
        address indexed owner,
        bytes32 deviceName,
        address registrar
    );
    /// @notice It had been registered for the wrong one.
    event DeviceOwnerChanged(address indexed device, address indexed owner, address registrar);
    event DeviceRevoked(address indexed device, Revocation reason);
    /// @param root of the statements that the device signed on `day`, counted from 1970-01-01 UTC
    /// @param uri location of the log of that day
    event WitnessRoot(address indexed device, uint64 indexed day, bytes32 root, string uri);

    error DeviceAlreadyRegistered(address device);
    /// @notice The signature is of another key, or says something else: another owner, registry or chain, or what was
    /// used before.
    error NotSignedByDevice(address device, address owner);
    error UnknownDevice(address device);
    error DeviceAlreadyRevoked(address device, uint256 revokedAt);
    error InvalidDevice(address device, bytes32 role, address owner, bytes32 name);
    /// @param holder the key that has this role and name now; revoke it first
    error DeviceNameTaken(bytes32 role, bytes32 name, address holder);
    error RevocationWithoutReason(address device);
    /// @notice The caller is neither an operator nor the device's owner.
    error NotDeviceOwner(address device, address caller, address owner);
    error NotOrganization(address caller);
    error RootAlreadyPosted(address device, uint64 day, bytes32 root);
    error InvalidRoot(address device, uint64 day, bytes32 root, uint64 today);

    /// @notice See IOrganization.registerDevice. Only the organization.
    /// @param role what it is, ASCII: robot, bin, meter, mocap
    /// @param owner who answers for it
    /// @param name on its site, ASCII
    /// @param r of the key's signature (EIP-712, EIP-2098) of Possession(device, owner, deviceNonce)
    /// @param vs the rest of that signature
    /// @param registrar the administrator who registers it
    function registerDevice(
        address device_,
        bytes32 role,
        address owner,
        bytes32 name,
        bytes32 r,
        bytes32 vs,
        address registrar
    ) external;

    /// @notice How often the key's signature was used: the next one has to name this number.
    function deviceNonce(address device_) external view returns (uint256);

    /// @notice See IOrganization.revokeDevice. Only the organization.
    /// @param reason Compromised: what it signed before counts no more either
    function revokeDevice(address device_, Revocation reason) external;

    /// @notice Fix what the device signed on a day, today or earlier. Once per day. Only an operator or the device's
    /// owner.
    /// @param day days since 1970-01-01 (UTC)
    /// @param root hash of the log of that day
    /// @param uri where the log lies
    function postRoot(address device_, uint64 day, bytes32 root, string calldata uri) external;

    /// @notice The root of the statements that the device signed on `day`; 0 if none was posted.
    /// @param day days since 1970-01-01 (UTC)
    function rootOf(address device_, uint64 day) external view returns (bytes32);

    /// @notice The device's record. Reverts with UnknownDevice.
    function device(address device_) external view returns (Device memory);

    /// @notice The key that has `name` in `role` now; 0 if none has.
    /// @param role what it is, ASCII
    /// @param name on its site, ASCII
    function deviceNamed(bytes32 role, bytes32 name) external view returns (address);
}
