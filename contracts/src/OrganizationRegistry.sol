// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Create2} from "@openzeppelin/contracts/utils/Create2.sol";
import {Founding, IOrganizationRegistry, Part} from "./interfaces/IOrganizationRegistry.sol";

/// @title Creates one contract, whose address depends on this one's alone.
/// @dev The contracts of an organization have each other's addresses among their arguments. Under CREATE2 alone an
/// address would follow from the arguments, and these from the address.
contract Cradle {
    address private immutable _registry = msg.sender;

    error NotRegistry(address caller);

    /// @notice Reverts with what the constructor reverts with.
    /// @param initCode creation code with its arguments
    function create(bytes calldata initCode) external returns (address created) {
        if (msg.sender != _registry) revert NotRegistry(msg.sender);
        bytes memory code = initCode;
        assembly ("memory-safe") {
            created := create(0, add(code, 0x20), mload(code))
            if iszero(created) {
                let pointer := mload(0x40)
                returndatacopy(pointer, 0, returndatasize())
                revert(pointer, returndatasize())
            }
        }
    }
}

contract OrganizationRegistry is IOrganizationRegistry {
    bytes32 private constant CRADLE_HASH = keccak256(type(Cradle).creationCode);

    /// @inheritdoc IOrganizationRegistry
    mapping(bytes32 part => bytes32) public codeHashOf;
    /// @inheritdoc IOrganizationRegistry
    mapping(address created => bytes32) public initCodeHashOf;
    mapping(bytes32 organizationId => uint64) private _foundedIn;
    Founding[] private _foundings;

    /// @param parts what organizations of this release are made of
    /// @param codeHashes of their creation code, without arguments
    constructor(bytes32[] memory parts, bytes32[] memory codeHashes) {
        if (parts.length != codeHashes.length) revert HashesMissing(parts.length, codeHashes.length);
        for (uint256 i = 0; i < parts.length; ++i) {
            codeHashOf[parts[i]] = codeHashes[i];
        }
    }

    /// @inheritdoc IOrganizationRegistry
    function create(bytes32 name, uint32 number, Part[] calldata parts) external {
        bytes32 id = _id(msg.sender, name, number);
        if (_foundedIn[id] == 0) {
            _foundedIn[id] = uint64(block.number);
            _foundings.push(Founding(msg.sender, number, uint64(block.number), name));
            emit OrganizationFounded(msg.sender, name, number);
        }
        for (uint256 i = 0; i < parts.length; ++i) {
            _create(id, parts[i]);
        }
    }

    /// @inheritdoc IOrganizationRegistry
    function addressOf(address founder, bytes32 name, uint32 number, bytes32 part)
        external
        view
        returns (address)
    {
        return _addressOf(_id(founder, name, number), part);
    }

    /// @inheritdoc IOrganizationRegistry
    function foundedIn(address founder, bytes32 name, uint32 number) external view returns (uint64) {
        return _foundedIn[_id(founder, name, number)];
    }

    /// @inheritdoc IOrganizationRegistry
    function organizationCount() external view returns (uint256) {
        return _foundings.length;
    }

    /// @inheritdoc IOrganizationRegistry
    function organization(uint256 index) external view returns (Founding memory) {
        return _foundings[index];
    }

    function _create(bytes32 id, Part calldata part) private {
        bytes32 codeHash = keccak256(part.code);
        bytes32 expected = codeHashOf[part.name];
        if (codeHash != expected) revert OtherCode(part.name, codeHash, expected);
        bytes memory initCode = bytes.concat(part.code, part.arguments);
        bytes32 initCodeHash = keccak256(initCode);
        address created = _addressOf(id, part.name);
        bytes32 before = initCodeHashOf[created];
        if (before == initCodeHash) return;
        if (before != 0) revert OtherArguments(part.name, created);
        // Known before its constructor runs, which may call foreign code.
        initCodeHashOf[created] = initCodeHash;
        assert(new Cradle{salt: _salt(id, part.name)}().create(initCode) == created);
        emit ContractCreated(created, part.name, initCodeHash);
    }

    function _id(address founder, bytes32 name, uint32 number) private pure returns (bytes32) {
        return keccak256(abi.encode(founder, name, number));
    }

    function _salt(bytes32 id, bytes32 part) private pure returns (bytes32) {
        return keccak256(abi.encode(id, part));
    }

    function _addressOf(bytes32 id, bytes32 part) private view returns (address) {
        address cradle = Create2.computeAddress(_salt(id, part), CRADLE_HASH);
        // keccak256(rlp([cradle, 1])): a contract's first nonce is 1 (EIP-161).
        return address(uint160(uint256(keccak256(abi.encodePacked(hex"d694", cradle, hex"01")))));
    }
}
