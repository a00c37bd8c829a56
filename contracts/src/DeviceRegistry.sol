// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {SafeCast} from "@openzeppelin/contracts/utils/math/SafeCast.sol";
import {Device, IDeviceRegistry, Revocation} from "./interfaces/IDeviceRegistry.sol";
import {Texts} from "./libraries/Texts.sol";

/// @dev The inheriting contract decides who may register.
abstract contract DeviceRegistry is IDeviceRegistry {
    using SafeCast for uint256;

    mapping(address device => Device) private _devices;
    /// @inheritdoc IDeviceRegistry
    mapping(bytes32 role => mapping(bytes32 name => address)) public deviceNamed;
    /// @inheritdoc IDeviceRegistry
    mapping(address device => mapping(uint64 day => bytes32)) public rootOf;

    /// @inheritdoc IDeviceRegistry
    function device(address device_) external view returns (Device memory) {
        return _device(device_);
    }

    function _registerDevice(address device_, bytes32 role, address owner, bytes32 name) internal {
        if (device_ == address(0) || role == 0 || owner == address(0) || name == 0) {
            revert InvalidDevice(device_, role, owner, name);
        }
        if (_devices[device_].registeredAt != 0) revert DeviceAlreadyRegistered(device_);
        address holder = deviceNamed[role][name];
        if (holder != address(0)) revert DeviceNameTaken(role, name, holder);
        deviceNamed[role][name] = device_;
        _devices[device_] = Device({
            role: role,
            name: name,
            owner: owner,
            registeredAt: block.timestamp.toUint48(),
            revokedAt: 0,
            registrar: msg.sender,
            revocation: Revocation.None
        });
        emit DeviceRegistered(device_, role, owner, name, msg.sender);
    }

    function _revokeDevice(address device_, Revocation reason) internal {
        if (reason == Revocation.None) revert RevocationWithoutReason(device_);
        Device storage d = _device(device_);
        if (d.revokedAt != 0) revert DeviceAlreadyRevoked(device_, d.revokedAt);
        d.revokedAt = block.timestamp.toUint48();
        d.revocation = reason;
        delete deviceNamed[d.role][d.name];
        emit DeviceRevoked(device_, reason);
    }

    function _postRoot(address device_, uint64 day, bytes32 root, string calldata uri) internal {
        uint64 today = uint64(block.timestamp / 1 days);
        if (root == 0 || day > today) revert InvalidRoot(device_, day, root, today);
        bytes32 posted = rootOf[device_][day];
        if (posted != 0) revert RootAlreadyPosted(device_, day, posted);
        Texts.requireText(uri);
        rootOf[device_][day] = root;
        emit WitnessRoot(device_, day, root, uri);
    }

    function _device(address device_) internal view returns (Device storage d) {
        d = _devices[device_];
        if (d.registeredAt == 0) revert UnknownDevice(device_);
    }
}
