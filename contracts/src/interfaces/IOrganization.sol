// SPDX-License-Identifier: MIT
pragma solidity ^0.8.28;

import {IERC20} from "@openzeppelin/contracts/token/ERC20/IERC20.sol";
import {IDeviceRegistry} from "./IDeviceRegistry.sol";
import {IMatchingPolicy} from "./IMatchingPolicy.sol";
import {IServiceManager, ServiceState} from "./IServiceManager.sol";
import {ITaskManager, TaskRequest} from "./ITaskManager.sol";

/// @title The organization: who may do what, which work it accepts, how tasks meet services, and its treasury.
/// @notice It is itself a participant: its operator posts tasks and offers services in its name, rewards come
/// from and income goes to its own token balance. The administrator (OpenZeppelin's default admin, handed over
/// in two steps) grants the other roles.
interface IOrganization is IDeviceRegistry {
    event KindAllowed(bytes32 indexed kind, bool allowed);
    event PolicyChanged(IMatchingPolicy indexed policy);
    event Deposited(address indexed from, uint256 amount);
    event Withdrawn(address indexed to, uint256 amount);

    error UnknownKind(bytes32 kind);
    error InvalidPolicy(address policy);

    // -- administrator ------------------------------------------------------------------------------------

    /// @notice Accept tasks and services of `kind` from now on, or no longer. Live ones go on.
    function allowKind(bytes32 kind, bool allowed) external;

    /// @notice Replace the matching policy. Queues and live tasks stay as they are.
    function setPolicy(IMatchingPolicy policy) external;

    // -- operator -----------------------------------------------------------------------------------------

    /// @notice ITaskManager.registerTask in the organization's name.
    function registerTask(TaskRequest calldata request) external returns (uint256 taskId);

    /// @notice ITaskManager.cancelTask in the organization's name.
    function cancelTask(uint256 taskId) external;

    /// @notice ITaskManager.submitProof in the organization's name.
    function submitProof(uint256 taskId, uint8 attempt, bytes32 proofHash, string calldata uri) external;

    /// @notice IServiceManager.registerService in the organization's name.
    function registerService(bytes32 kind, uint256 price, string calldata description)
        external
        returns (uint256 serviceId);

    /// @notice IServiceManager.updateService in the organization's name.
    function updateService(uint256 serviceId, uint256 price, ServiceState state) external;

    // -- treasurer ----------------------------------------------------------------------------------------

    /// @notice Move `amount` of the caller's tokens into the treasury; the caller approved it before.
    function deposit(uint256 amount) external;

    /// @notice Pay `amount` out of the treasury. What is in escrow is out of reach.
    function withdraw(address to, uint256 amount) external;

    // -- views --------------------------------------------------------------------------------------------

    function token() external view returns (IERC20);
    function services() external view returns (IServiceManager);
    function tasks() external view returns (ITaskManager);
    function policy() external view returns (IMatchingPolicy);

    function isKindAllowed(bytes32 kind) external view returns (bool);

    /// @notice Reverts with UnknownKind unless `kind` is allowed.
    function requireKind(bytes32 kind) external view;

    /// @notice Whether `account` may post verdicts.
    function isOracle(address account) external view returns (bool);

    /// @notice What the policy says, checked. Never reverts, so that a bad policy cannot keep money in escrow.
    /// @return serviceId an idle service of `kind` that costs at most `reward`; 0 when there is none
    /// @return failed whether the policy reverted, ran out of its gas or chose an unfit service
    function selectService(bytes32 kind, uint256 reward)
        external
        view
        returns (uint256 serviceId, bool failed);
}
