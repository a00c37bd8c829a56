// SPDX-License-Identifier: MIT
pragma solidity ^0.8.28;

import {SafeCast} from "@openzeppelin/contracts/utils/math/SafeCast.sol";
import {Device, IDeviceRegistry} from "./interfaces/IDeviceRegistry.sol";

/// @dev Who may register is up to the contract that inherits this.
abstract contract DeviceRegistry is IDeviceRegistry {
    using SafeCast for uint256;

    mapping(address device => Device) private _devices;

    /// @inheritdoc IDeviceRegistry
    function device(address device_) external view returns (Device memory) {
        return _device(device_);
    }

    function _registerDevice(address device_, bytes32 role, address owner) internal {
        if (device_ == address(0) || role == 0 || owner == address(0)) {
            revert InvalidDevice(device_, role, owner);
        }
        if (_devices[device_].registeredAt != 0) revert DeviceAlreadyRegistered(device_);
        _devices[device_] = Device(role, owner, block.timestamp.toUint48(), 0, msg.sender);
        emit DeviceRegistered(device_, role, owner, msg.sender);
    }

    function _revokeDevice(address device_) internal {
        Device storage d = _device(device_);
        if (d.revokedAt != 0) revert DeviceAlreadyRevoked(device_, d.revokedAt);
        d.revokedAt = block.timestamp.toUint48();
        emit DeviceRevoked(device_);
    }

    function _device(address device_) private view returns (Device storage d) {
        d = _devices[device_];
        if (d.registeredAt == 0) revert UnknownDevice(device_);
    }
}
