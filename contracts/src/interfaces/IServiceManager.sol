// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {KindId} from "../types/KindId.sol";
import {ServiceId} from "../types/ServiceId.sol";
import {TaskId} from "../types/TaskId.sol";

/// @notice A task names nobody, so that the policy chooses, or one service, or one provider.
enum Hire {
    None,
    Service,
    Provider
}

/// @notice The provider sets Active, Paused and Retired. Only Active services get new tasks, and Retired is final. The
/// organization, or the terms after repeated failures, set Suspended; the provider can only retire the service then.
/// Short: what is left of the bond does not cover another penalty, until a case ends for which a part of it is set aside. The
/// service is Active again then.
enum ServiceState {
    None,
    Active,
    Paused,
    Retired,
    Suspended,
    Short
}

/// @notice How an attempt ended for the service that made it. Unjudged: it was void, impossible or given up. Missed:
/// without a proof, and the provider had not agreed to it. Abandoned: the provider gave it back early. Pending: a ruling
/// stands that may be replaced, so that it has ended for the service and not for its record.
enum Outcome {
    Completed,
    Rejected,
    Expired,
    Unjudged,
    Missed,
    Abandoned,
    Pending
}

/// @param price what one task costs, in the token's smallest unit
/// @param taskId the task it is doing; 0 when it does none
/// @param place its place among the idle services: lower was there earlier; 0 when it does not wait
/// @param completed attempts that were accepted
/// @param rejected attempts that were rejected
/// @param expired attempts without a proof in time
/// @param reputation of its provider, in 64ths: the share of work well done in the work that others paid for, by value.
/// 32 for a newcomer. Waiting services are compared by eighths, as they were when they began to wait
/// @param bond what is left of the bond, in the token's smallest unit
/// @param penalty what a failed attempt takes from the bond; agreed at registration
/// @param maxFailures failures in a row of its provider that suspend it; 0 for no limit; agreed at registration
/// @param failures failures in a row until now of all services of the provider
/// @param autoAccept the provider accepts each task that the service is assigned
struct Service {
    address provider;
    uint96 price;
    bytes32 kind;
    TaskId taskId;
    uint64 place;
    ServiceState state;
    uint32 completed;
    uint32 rejected;
    uint32 expired;
    uint8 reputation;
    uint96 bond;
    uint96 penalty;
    uint8 maxFailures;
    uint8 failures;
    bool autoAccept;
}

/// @param payout who is paid: the provider's payout address
/// @param available whether the provider wants another task; it waits in its line for it if it was given a place there
/// @param kindId of which number that one is, see IOrganization.numberOf
/// @param price what that one costs
/// @param penalty taken from the bond for the attempt that ended, or set aside
/// @param bond to be returned, because the service retired while it was at work
/// @param named if a task may wait that names the service, its number; if one may that names its provider, the
/// provider's address as a number; else 0
struct Release {
    address payout;
    bool available;
    KindId kindId;
    uint256 price;
    uint256 penalty;
    uint256 bond;
    uint256 named;
}

/// @title Services: who does which work at which price, and which services wait for a task.
/// @notice A service does one task at a time. Its provider can change price and state meanwhile; both apply from the
/// next task on. A service keeps the terms that the organization had when it was registered. The task manager holds
/// its bond, as it holds all money.
interface IServiceManager {
    event ServiceRegistered(
        ServiceId indexed serviceId,
        address indexed provider,
        bytes32 indexed kind,
        uint256 price,
        bool autoAccept,
        string description
    );
    event ServiceUpdated(ServiceId indexed serviceId, uint256 price, ServiceState state);
    /// @notice Follows ServiceRegistered where the organization has terms.
    event TermsAgreed(ServiceId indexed serviceId, uint256 bond, uint256 penalty, uint8 maxFailures);
    /// @param amount what the failed attempt took from the bond, for the organization's treasury
    event BondPenalized(ServiceId indexed serviceId, TaskId indexed taskId, uint256 amount);
    /// @notice Until the case of this task ends, this part of the bond secures nothing else.
    event PenaltySetAside(ServiceId indexed serviceId, TaskId indexed taskId, uint256 amount);
    event PenaltyReturned(ServiceId indexed serviceId, TaskId indexed taskId, uint256 amount);
    /// @notice With what is set aside, the bond does not cover another penalty: the service is Short.
    event BondRanShort(ServiceId indexed serviceId, uint256 bond, uint256 penalty);
    /// @notice Its provider agreed to the judge that the kind has now.
    event ServiceAgreed(ServiceId indexed serviceId, KindId kindId);
    /// @param provider whose payout address gets it
    event BondReturned(ServiceId indexed serviceId, address indexed provider, uint256 amount);
    /// @notice From now on `payout` gets what the contracts owe `provider` for work, bonds and stakes.
    event PayoutChanged(address indexed provider, address indexed payout);
    event ServiceSuspended(ServiceId indexed serviceId);
    /// @notice Its provider is asleep, and this service has missed an attempt, too: it is paused.
    event ServiceFellAsleep(ServiceId indexed serviceId);
    /// @notice The provider has let too many attempts pass without a proof.
    /// @param until when it may wake up
    event ProviderFellAsleep(address indexed provider, uint256 until);
    /// @notice The provider called `wakeUp`, or a proof of it was accepted.
    event ProviderWokeUp(address indexed provider);
    /// @notice The service is paused now, and its failures are forgiven.
    event ServiceReinstated(ServiceId indexed serviceId);

    error UnknownService(ServiceId serviceId);
    /// @notice A task names a service that does other work.
    error ServiceOfOtherKind(ServiceId serviceId, bytes32 kind);
    /// @notice A task names a provider that does no such work. The organization cannot be named: it has any number of
    /// services, so that a task names the service.
    error ProviderWithoutService(address provider, bytes32 kind);
    error NotProvider(ServiceId serviceId, address caller, address provider);
    error ServiceIsRetired(ServiceId serviceId);
    /// @notice The provider can only retire it.
    error ServiceIsSuspended(ServiceId serviceId);
    error ServiceNotSuspended(ServiceId serviceId, ServiceState state);
    error ServiceIsBusy(ServiceId serviceId, TaskId taskId);
    /// @notice The rest of the bond does not cover a penalty: wait until the cases end for which a part is set aside, or
    /// retire the service and register a new one.
    error BondExhausted(ServiceId serviceId, uint256 bond, uint256 penalty);
    /// @notice A provider can set Active, Paused and Retired.
    error InvalidServiceState(ServiceState state);
    /// @notice The organization asks for a higher bond than the provider agreed to.
    error BondTooHigh(uint256 bond, uint256 maxBond);
    /// @notice A price is a multiple of `unit`, so that it can be compared in 57 bits, and at most `max`. The unit is a
    /// billionth of a token, or the token's smallest if it has 9 decimals or fewer.
    error InvalidPrice(uint256 price, uint256 unit, uint256 max);
    error ServiceNotIdle(ServiceId serviceId);
    /// @notice The organization's policy may need so much, and the caller left less: it would have failed for that alone.
    error TooLittleGas(uint256 needed);
    /// @notice Retire one first. One that retired at work counts until its task ends.
    error TooManyServices(address provider, uint256 max);
    /// @notice The provider has let too many attempts pass without a proof. It may call `wakeUp` at `until`.
    error ProviderIsAsleep(address provider, uint256 until);
    error ProviderIsAwake(address provider);
    /// @notice Only the payout address changes itself. It is the provider's own until it names another one.
    error NotPayout(address provider, address caller, address payout);
    /// @notice Somebody has to be paid: the provider's own address undoes the change.
    error NoPayout(address provider);
    error NotTaskManager(address caller);
    error NotOrganization(address caller);

    /// @notice Offer work of a kind. The service is assigned the next open task that it can do, or waits for one.
    /// The caller pays the bond of the organization's terms, and approves the task manager for it before. A provider
    /// has up to MAX_SERVICES services; the organization has no limit.
    /// @param kind what is done, ASCII
    /// @param price what one task costs, in the token's smallest unit
    /// @param maxBond the highest bond that the caller agrees to, so that terms that change meanwhile surprise nobody
    /// @param autoAccept the caller accepts each task that the service is assigned. Otherwise it accepts each by
    /// ITaskManager.acceptTask, as is advisable where the parameters of tasks are free text.
    /// @param description free text; only in the event
    /// @return serviceId the number of the service, counted from 1
    function registerService(
        bytes32 kind,
        uint256 price,
        uint256 maxBond,
        bool autoAccept,
        string calldata description
    ) external returns (ServiceId serviceId);

    /// @notice Change price and state of a service from its next task on. A service that waits moves to the end of its
    /// line. A retired service's bond goes to its provider's payout address: at once when the service is idle, else
    /// when its task ends. That address may retire the service, too. A provider that is asleep cannot activate a
    /// service (see wakeUp).
    /// @param serviceId a service of the caller, or of whoever the caller is the payout address
    /// @param price what one task costs, in the token's smallest unit
    /// @param state Active, Paused or Retired
    function updateService(ServiceId serviceId, uint256 price, ServiceState state) external;

    /// @notice The caller agrees that its service gets tasks which the judge decides about that its kind has now. Until then
    /// it gets those that were posted under the judge before. Its bond stays.
    /// @param serviceId an idle service of the caller
    function agree(ServiceId serviceId) external;

    /// @notice The caller, who fell asleep, takes part again. Its services stay paused until it activates them.
    function wakeUp() external;

    /// @notice Have payments for the provider's work, and its bonds and stakes, go to another address. A provider names
    /// one once. Then only that address can name the next, so that whoever takes the provider's key cannot take what
    /// it earns. Applies to whatever is paid from now on. What a creator has back of its rewards stays with the creator.
    /// @param provider whose payments go there; the caller has to be its payout address
    /// @param payout who is paid; the provider's own address gives the right to choose back to the provider
    function setPayout(address provider, address payout) external;

    /// @notice Returns a service as it is now. Reverts with UnknownService.
    /// @param serviceId its number
    function service(ServiceId serviceId) external view returns (Service memory);

    /// @notice Returns the account that does the service's tasks. It never changes. Reverts with UnknownService.
    /// @param serviceId its number
    function providerOf(ServiceId serviceId) external view returns (address);

    /// @notice Returns who is paid what the contracts owe an account: itself, or the address that it has named.
    /// @param account any account
    function payoutOf(address account) external view returns (address);

    /// @notice Returns whether two accounts are the same, or one owns the other, or somebody owns both, as the organization's
    /// registry of devices knows.
    /// @param account any account
    /// @param other any account
    function areRelated(address account, address other) external view returns (bool);

    /// @notice Returns the first of `accounts` that would profit from a ruling: that is the creator or the provider, or is
    /// related to one of them. 0 if none is.
    /// @param accounts who judges
    /// @param serviceId the service that does the task
    /// @param creator who posted it
    function partyAmong(address[] calldata accounts, ServiceId serviceId, address creator)
        external
        view
        returns (address);

    /// @notice When a provider that fell asleep may wake up; 0 while it is awake.
    /// @param provider who offers services
    function asleepUntil(address provider) external view returns (uint256);

    /// @notice Returns a provider's service: the cheapest that is free and costs at most `maxPrice`, else any. Reverts
    /// with ProviderWithoutService.
    /// @param provider who offers it; the organization's services are not found
    /// @param kind what is done, ASCII
    /// @param maxPrice the most it may cost, in the token's smallest unit
    /// @return serviceId its number
    function serviceOf(address provider, bytes32 kind, uint256 maxPrice)
        external
        view
        returns (ServiceId serviceId);

    /// @notice Returns how many services were ever registered, which is the last id.
    function serviceCount() external view returns (uint256);

    /// @notice Returns the waiting service that has waited longest.
    /// @param kindId the number of what is done, see IOrganization.numberOf
    /// @param maxPrice the most it may cost, in the token's smallest unit
    /// @return serviceId 0 if no such service waits
    function longestIdle(KindId kindId, uint256 maxPrice) external view returns (ServiceId serviceId);

    /// @notice Returns the cheapest waiting service. Among equals it prefers the best reputation, then the longest
    /// wait.
    /// @param kindId the number of what is done, see IOrganization.numberOf
    /// @param maxPrice the most it may cost, in the token's smallest unit
    /// @return serviceId 0 if no such service waits
    function cheapestIdle(KindId kindId, uint256 maxPrice) external view returns (ServiceId serviceId);

    /// @notice Returns the waiting service with the best reputation. Among equals it prefers the lowest price, then
    /// the longest wait.
    /// @param kindId the number of what is done, see IOrganization.numberOf
    /// @param maxPrice the most it may cost, in the token's smallest unit
    /// @return serviceId 0 if no such service waits
    function mostReputableIdle(KindId kindId, uint256 maxPrice) external view returns (ServiceId serviceId);

    /// @notice Give the service no new task until it is reinstated. A running task continues. Only the organization.
    /// @param serviceId its number
    function suspend(ServiceId serviceId) external;

    /// @notice Suspend all services of a provider. Those of the organization itself stay. Only the organization.
    /// @param provider who offers them
    function suspendServicesOf(address provider) external;

    /// @notice Remember who owns a device: what one does for the other does not count for its reputation. Only the
    /// organization, which registers devices.
    /// @param device the device's key
    /// @param owner the participant that owns the device
    function recordOwner(address device, address owner) external;

    /// @notice Returns the idle service that a policy chooses for a task. Never reverts because of the policy.
    /// @param policy the organization's, an IMatchingPolicy
    /// @param kindId the number of what is to be done, see IOrganization.numberOf
    /// @param reward the most it may cost, in the token's smallest unit
    /// @return serviceId what the policy says, whether or not there is such a service; a number that no service has if it
    /// fails, and 0 if it finds none
    function serviceFor(address policy, KindId kindId, uint256 reward)
        external
        view
        returns (ServiceId serviceId);

    /// @notice Returns the waiting task that the organization's policy chooses for a service that is free, among those that
    /// name nobody. Reverts with UnknownService; never because of the policy.
    /// @param serviceId its number
    /// @return taskId what the policy says, whether or not there is such a task; a number that no task has if it fails
    function taskFor(ServiceId serviceId) external view returns (TaskId taskId);

    /// @notice End a suspension, and forgive the provider its failures. Only the organization.
    /// @param serviceId its number
    function reinstate(ServiceId serviceId) external;

    /// @notice Give a task to a service, if it is available, of this kind, and not too expensive. Only the task
    /// manager.
    /// @param serviceId the service that the policy chose, or that the task names; 0 for the one that has waited longest
    /// @param kindId the number of what is done, see IOrganization.numberOf
    /// @param maxPrice the most it may cost, in the token's smallest unit
    /// @param taskId the task that it gets
    /// @param hired whether the task names the service, or its provider. It then waits for it, and `release` says so.
    /// Reverts with UnknownService or ServiceOfOtherKind if it would wait forever.
    /// @return taker the service; where the task names a provider maybe another one of it; 0 if there is none
    /// @return provider who does the task; 0 if the service does not fit, and nothing happened
    /// @return price the price of this task
    /// @return accepted whether the service accepts each task
    function reserve(ServiceId serviceId, KindId kindId, uint256 maxPrice, TaskId taskId, Hire hired)
        external
        returns (ServiceId taker, address provider, uint256 price, bool accepted);

    /// @notice End the service's task. Only the task manager, which pays what this returns, and places the service.
    /// @param serviceId the service that did the task
    /// @param outcome how the attempt ended
    /// @param value what the service was paid, or would have been, in the token's smallest unit: so much the outcome
    /// counts for the reputation of its provider
    /// @param creator who posted the task. It does not count for its own provider, nor for one of the same owner
    /// @param place its place in line, if it is available and no task waits; 0 if one may wait
    function release(ServiceId serviceId, Outcome outcome, uint256 value, address creator, uint40 place)
        external
        returns (Release memory);

    /// @notice The case of an attempt is over whose service was released before. Only the task manager, which pays what this
    /// returns.
    /// @param serviceId the service that made the attempt
    /// @param taskId the task
    /// @param outcome Completed, Rejected or Unjudged
    /// @param value as for release
    /// @param creator as for release
    /// @param penalty what release set aside: lost with Rejected, else it is part of the bond again
    function conclude(
        ServiceId serviceId,
        TaskId taskId,
        Outcome outcome,
        uint256 value,
        address creator,
        uint96 penalty
    ) external returns (Release memory);

    /// @notice A task that others abandoned was possible after all: each of them missed it. Only the task manager, before
    /// it releases the service.
    /// @param taskId the task
    /// @param serviceId the service whose proof was accepted
    /// @param creator who posted the task. What the provider's own owner posted proves nothing about others
    function countAbandoned(TaskId taskId, ServiceId serviceId, address creator) external;

    /// @notice Let an available service wait behind the others of its kind. Only the task manager.
    /// @param serviceId its number
    /// @param place its place among the waiting services; a higher number than any before
    function enqueue(ServiceId serviceId, uint40 place) external;
}
