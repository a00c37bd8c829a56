// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

// Who may do what in an organization: the roles that its contract grants (OpenZeppelin's AccessControl). They are constants
// of the sources and not functions of the contract, so that every contract that asks for a role means the same one.

/// @dev Grants the other roles and sets the rules: OpenZeppelin's DEFAULT_ADMIN_ROLE. One account, handed over in two steps.
bytes32 constant ADMINISTRATOR_ROLE = 0;
/// @dev Posts tasks and offers services in the organization's name.
bytes32 constant OPERATOR_ROLE = keccak256("OPERATOR_ROLE");
/// @dev Pays into the treasury, and out of it.
bytes32 constant TREASURER_ROLE = keccak256("TREASURER_ROLE");
/// @dev Rules on proofs, as RoleJudge has it.
bytes32 constant ORACLE_ROLE = keccak256("ORACLE_ROLE");
/// @dev Rules on what others pass on, or alone, as RoleJudge has it.
bytes32 constant AUDITOR_ROLE = keccak256("AUDITOR_ROLE");
/// @dev Posts tasks and offers services where only members do, and votes where members decide.
bytes32 constant MEMBER_ROLE = keccak256("MEMBER_ROLE");
/// @dev Pauses new tasks, and removes judges.
bytes32 constant GUARDIAN_ROLE = keccak256("GUARDIAN_ROLE");
/// @dev Pays shares that members voted for (BudgetVotes). Only a contract has it.
bytes32 constant ALLOCATOR_ROLE = keccak256("ALLOCATOR_ROLE");
