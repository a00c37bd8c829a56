// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IAccessControl} from "@openzeppelin/contracts/access/IAccessControl.sol";
import {ECDSA} from "@openzeppelin/contracts/utils/cryptography/ECDSA.sol";
import {EIP712} from "@openzeppelin/contracts/utils/cryptography/EIP712.sol";
import {SafeCast} from "@openzeppelin/contracts/utils/math/SafeCast.sol";
import {Device, IDeviceRegistry, Revocation} from "./interfaces/IDeviceRegistry.sol";
import {Texts} from "./libraries/Texts.sol";

contract DeviceRegistry is IDeviceRegistry, EIP712 {
    using SafeCast for uint256;

    bytes32 private constant POSSESSION_TYPEHASH =
        keccak256("Possession(address device,address owner,uint256 nonce)");

    /// @dev IOrganization's.
    bytes32 private constant OPERATOR_ROLE = keccak256("OPERATOR_ROLE");

    address private immutable _organization = msg.sender;

    mapping(address device => Device) private _devices;
    /// @inheritdoc IDeviceRegistry
    mapping(bytes32 role => mapping(bytes32 name => address)) public deviceNamed;
    /// @inheritdoc IDeviceRegistry
    mapping(address device => mapping(uint64 day => bytes32)) public rootOf;
    /// @inheritdoc IDeviceRegistry
    mapping(address device => uint256) public deviceNonce;

    modifier onlyOrganization() {
        if (msg.sender != _organization) revert NotOrganization(msg.sender);
        _;
    }

    constructor() EIP712("RODEO DeviceRegistry", "1") {}

    /// @inheritdoc IDeviceRegistry
    function registerDevice(
        address device_,
        bytes32 role,
        address owner,
        bytes32 name,
        bytes32 r,
        bytes32 vs,
        address registrar
    ) external onlyOrganization {
        if (device_ == address(0) || role == 0 || owner == address(0) || name == 0) {
            revert InvalidDevice(device_, role, owner, name);
        }
        Device storage d = _devices[device_];
        if (d.registeredAt != 0) {
            bool another = d.role != role || d.name != name;
            if (another || d.owner == owner || d.revokedAt != 0) revert DeviceAlreadyRegistered(device_);
            _requirePossession(device_, owner, r, vs);
            d.owner = owner;
            emit DeviceOwnerChanged(device_, owner, registrar);
            return;
        }
        address holder = deviceNamed[role][name];
        if (holder != address(0)) revert DeviceNameTaken(role, name, holder);
        _requirePossession(device_, owner, r, vs);
        deviceNamed[role][name] = device_;
        _devices[device_] = Device({
            role: role,
            name: name,
            owner: owner,
            registeredAt: block.timestamp.toUint48(),
            revokedAt: 0,
            registrar: registrar,
            revocation: Revocation.None
        });
        emit DeviceRegistered(device_, role, owner, name, registrar);
    }

    /// @inheritdoc IDeviceRegistry
    function revokeDevice(address device_, Revocation reason) external onlyOrganization {
        if (reason == Revocation.None) revert RevocationWithoutReason(device_);
        Device storage d = _device(device_);
        if (d.revokedAt != 0) revert DeviceAlreadyRevoked(device_, d.revokedAt);
        d.revokedAt = block.timestamp.toUint48();
        d.revocation = reason;
        delete deviceNamed[d.role][d.name];
        emit DeviceRevoked(device_, reason);
    }

    /// @inheritdoc IDeviceRegistry
    function postRoot(address device_, uint64 day, bytes32 root, string calldata uri) external {
        address owner = _device(device_).owner;
        if (msg.sender != owner && !IAccessControl(_organization).hasRole(OPERATOR_ROLE, msg.sender)) {
            revert NotDeviceOwner(device_, msg.sender, owner);
        }
        uint64 today = uint64(block.timestamp / 1 days);
        if (root == 0 || day > today) revert InvalidRoot(device_, day, root, today);
        bytes32 posted = rootOf[device_][day];
        if (posted != 0) revert RootAlreadyPosted(device_, day, posted);
        Texts.requireText(uri);
        rootOf[device_][day] = root;
        emit WitnessRoot(device_, day, root, uri);
    }

    /// @inheritdoc IDeviceRegistry
    function device(address device_) external view returns (Device memory) {
        return _device(device_);
    }

    /// @dev The key itself signed, and no earlier signature of it is used again.
    function _requirePossession(address device_, address owner, bytes32 r, bytes32 vs) private {
        bytes32 said = keccak256(abi.encode(POSSESSION_TYPEHASH, device_, owner, deviceNonce[device_]++));
        // Where it fails the signer is 0, which is no device.
        // slither-disable-next-line unused-return
        (address signer,,) = ECDSA.tryRecover(_hashTypedDataV4(said), r, vs);
        if (signer != device_) revert NotSignedByDevice(device_, owner);
    }

    function _device(address device_) private view returns (Device storage d) {
        d = _devices[device_];
        if (d.registeredAt == 0) revert UnknownDevice(device_);
    }
}
