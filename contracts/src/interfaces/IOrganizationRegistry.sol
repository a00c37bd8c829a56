// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

/// @notice One of an organization's contracts, on its way to the chain.
/// @param name ASCII: TaskManager
/// @param code its creation code, without arguments
/// @param arguments of its constructor, ABI-encoded
struct Part {
    bytes32 name;
    bytes code;
    bytes arguments;
}

/// @param founder who creates its contracts
/// @param number tells organizations of one founder and name apart
/// @param foundedIn block of its first contract
/// @param name ASCII, as the founder chose it: others may have founded some of the same name
struct Founding {
    address founder;
    uint32 number;
    uint64 foundedIn;
    bytes32 name;
}

/// @title Creates organizations of one release, at addresses that are known beforehand, and lists them.
/// @notice Belongs to nobody. Its own address follows from the code that it creates (CREATE2), so whatever it has
/// created is of that code, on every chain. It does not say what an organization is worth: anybody may found one, its
/// token may be any contract, and its founder chose who administers it.
interface IOrganizationRegistry {
    event OrganizationFounded(address indexed founder, bytes32 indexed name, uint32 number);
    event ContractCreated(address indexed created, bytes32 indexed part, bytes32 initCodeHash);

    /// @notice The constructor got more or fewer hashes than parts.
    error HashesMissing(uint256 parts, uint256 codeHashes);
    /// @notice This code is not that of the part of this name.
    error OtherCode(bytes32 part, bytes32 codeHash, bytes32 expected);
    /// @notice The part is there, and was created with other arguments.
    error OtherArguments(bytes32 part, address created);

    /// @notice Create contracts of the caller's organization. What is there already, with the same code and arguments,
    /// is left as it is, so that a transaction that may have been lost can be sent again.
    /// @param name ASCII
    /// @param number tells organizations of the caller with this name apart
    /// @param parts creation code and arguments of each contract, and its name
    function create(bytes32 name, uint32 number, Part[] calldata parts) external;

    /// @notice Where a part of an organization is, or will be.
    /// @param founder who creates them
    /// @param name of the organization, ASCII
    /// @param number tells organizations of the founder with this name apart
    /// @param part name of the contract, ASCII
    function addressOf(address founder, bytes32 name, uint32 number, bytes32 part)
        external
        view
        returns (address);

    /// @notice Hash of creation code and arguments of a contract that was created here; 0 for any other.
    /// @param created address of a contract
    function initCodeHashOf(address created) external view returns (bytes32);

    /// @notice Hash of the creation code, without arguments, of the part of this name; 0 if there is none.
    /// @param part name of a contract, ASCII
    function codeHashOf(bytes32 part) external view returns (bytes32);

    /// @notice The block of the organization's first contract; 0 if it has none.
    /// @param founder who created it
    /// @param name ASCII
    /// @param number tells organizations of the founder with this name apart
    function foundedIn(address founder, bytes32 name, uint32 number) external view returns (uint64);

    /// @notice How many organizations were founded.
    function organizationCount() external view returns (uint256);

    /// @notice In the order of their founding, from 0.
    /// @param index below organizationCount
    function organization(uint256 index) external view returns (Founding memory);
}
